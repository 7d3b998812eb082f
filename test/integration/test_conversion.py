"""ROS 1 to CDR, against rosbags' and rclpy's own (de)serialisation."""

import struct
from types import SimpleNamespace

import numpy as np
import pytest
from dvs_msgs.msg import EventArray
from event_bags import typestore
from harness import CAMERA
from rclpy.serialization import deserialize_message
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from sensor_msgs.msg import CameraInfo, Imu

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.ros1_conversion import Ros1Converter
from emoflow_ros.simulation.messages import EVENT_ARRAY, ImuSample, MessageEncoder

STAMP = 1_500_000_000_123_456_789
EVENT_DEFINITION = """\
std_msgs/Header header
uint32 height
uint32 width
dvs_msgs/Event[] events
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: dvs_msgs/Event
uint16 x
uint16 y
time ts
bool polarity
"""


@pytest.fixture
def converter() -> Ros1Converter:
    definition = MessageDefinition(MessageDefinitionFormat.MSG, EVENT_DEFINITION)
    connection = SimpleNamespace(msgtype=EVENT_ARRAY, msgdef=definition)
    return Ros1Converter([connection])


@pytest.fixture
def ros1() -> MessageEncoder:
    return MessageEncoder(ros1=True)


def some_events(count: int) -> Events:
    rng = np.random.default_rng(count)
    return Events(
        rng.integers(0, 64, count, np.uint16),
        rng.integers(0, 48, count, np.uint16),
        STAMP + np.sort(rng.integers(0, 10**9, count)),
        rng.random(count) < 0.5,
    )


@pytest.mark.parametrize("count", [0, 1, 2, 3, 500])
def test_event_array_is_what_rosbags_makes_of_it(
    converter: Ros1Converter, ros1: MessageEncoder, count: int
) -> None:
    events = some_events(count)
    data = ros1.events(STAMP, CAMERA, events)
    cdr = converter.to_cdr(data, EVENT_ARRAY)
    assert cdr == bytes(typestore(ros1=False).ros1_to_cdr(data, EVENT_ARRAY))


def test_event_array_is_read_by_rclpy(converter: Ros1Converter, ros1: MessageEncoder) -> None:
    events = some_events(20)
    message = deserialize_message(
        converter.to_cdr(ros1.events(STAMP, CAMERA, events), EVENT_ARRAY), EventArray
    )
    assert (message.width, message.height) == (64, 48)
    assert message.header.frame_id == "davis_left_optical"
    assert [e.x for e in message.events] == events.x.tolist()
    assert [e.y for e in message.events] == events.y.tolist()
    assert [e.polarity for e in message.events] == events.p.tolist()
    times = [e.ts.sec * 10**9 + e.ts.nanosec for e in message.events]
    assert times == events.t.tolist()


def test_standard_types_are_read_by_rclpy(converter: Ros1Converter, ros1: MessageEncoder) -> None:
    info = deserialize_message(
        converter.to_cdr(ros1.camera_info(STAMP, CAMERA), "sensor_msgs/msg/CameraInfo"), CameraInfo
    )
    np.testing.assert_array_equal(info.k.reshape(3, 3), CAMERA.intrinsic_matrix)
    sample = ImuSample(np.array([0.1, 0.2, 0.3]), np.array([1.0, -9.8, 2.0]))
    imu = deserialize_message(converter.to_cdr(ros1.imu(STAMP, sample), "sensor_msgs/msg/Imu"), Imu)
    assert (imu.angular_velocity.x, imu.linear_acceleration.y) == (0.1, -9.8)
    assert imu.orientation_covariance[0] == -1


@pytest.mark.parametrize("cut", [3, 20, 45, 60])
def test_truncated_event_array_is_refused(
    converter: Ros1Converter, ros1: MessageEncoder, cut: int
) -> None:
    data = ros1.events(STAMP, CAMERA, some_events(4))
    with pytest.raises(InputError, match="cannot be converted"):
        converter.to_cdr(data[:cut], EVENT_ARRAY)


def test_too_large_count_is_refused(converter: Ros1Converter, ros1: MessageEncoder) -> None:
    data = bytearray(ros1.events(STAMP, CAMERA, some_events(4)))
    struct.pack_into("<I", data, len(data) - 4 * 13 - 4, 5)
    with pytest.raises(InputError, match="cannot be converted"):
        converter.to_cdr(bytes(data), EVENT_ARRAY)


def test_undefined_type_is_refused(converter: Ros1Converter) -> None:
    with pytest.raises(InputError, match="my_msgs/msg/Odd"):
        converter.to_cdr(b"", "my_msgs/msg/Odd")
