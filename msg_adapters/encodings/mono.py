"""The deprecated `mono` encoding of event_camera_msgs: one 64-bit word per event.

Source: event_camera_codecs (ros-event-camera). Bits 0-31: ns since time_base, 32-47: column,
48-62: row, 63: polarity.
"""

import numpy as np

from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics
from msg_adapters.packet_decoder import view_words

ENCODING = "mono"

_WORD = np.dtype("<u8")
_FIELDS = np.dtype([("dt", "<u4"), ("x", "<u2"), ("y_and_p", "<u2")])
_ROW = np.uint16(0x7FFF)
_ON = np.uint16(0x8000)


class PacketDecoder:
    """Decode mono packets; carries no state between them."""

    def __init__(self, statistics: Statistics) -> None:
        self._statistics = statistics

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; times count from `time_base`."""
        fields = view_words(payload, _WORD, big_endian, self._statistics).view(_FIELDS)
        t = fields["dt"].astype(np.int64)
        t += time_base
        y = fields["y_and_p"] & _ROW
        return Events(fields["x"].astype(np.uint16), y, t, fields["y_and_p"] >= _ON)

    def resync(self) -> None:
        """Do nothing: packets stand alone."""

    def reset(self) -> None:
        """Do nothing: packets stand alone."""


DECODER = PacketDecoder
