"""Message bytes to event arrays: one decoder per topic, found by ROS type and encoding.

Imports neither rclpy nor torch. `formats/` holds one file per message type, `encodings/` one
file per encoding of event_camera_msgs/EventPacket; a new one is one new file there.
"""

from msg_adapters.message import DecodeError, Decoder, EventMessage, Statistics
from msg_adapters.registry import make_decoder, make_packet_decoder, supported_types

__all__ = [
    "DecodeError",
    "Decoder",
    "EventMessage",
    "Statistics",
    "make_decoder",
    "make_packet_decoder",
    "supported_types",
]
