"""dvs_msgs/EventArray, and the same of Prophesee's and iniVation's drivers: an array of structs.

Fields: Header header, uint32 height, uint32 width, Event[] events; Event: uint16 x, uint16 y,
time ts, bool polarity. ROS 1 packs an event into 13 bytes. CDR aligns each member on its own,
not the struct: one event starts 16 bytes after the other, but x and y of all but the first
follow the polarity of the event before after one byte of padding, and two more precede ts:

    first   x y | seconds nanoseconds polarity
    others  . x y . . | seconds nanoseconds polarity        (. is padding)
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import Events
from msg_adapters.message import (
    NS_PER_S,
    Bytes,
    Cursor,
    DecodeError,
    EventMessage,
    Serialization,
    Statistics,
    build_message,
    first_part,
)

type Structs = NDArray[np.void]

TYPES = tuple(
    f"{package}_msgs/msg/EventArray" for package in ("dvs", "prophesee_event", "dv_ros", "dv_ros2")
)

_EVENT_SIZE = 13  # without padding
_ALIGNMENT = 2  # of an event's first member


class _Layout(NamedTuple):
    """Bytes between events, where the second one starts, and the type of seconds."""

    stride: int
    next: int
    seconds: str


_CDR = _Layout(16, 14, "i4")
_ROS1 = _Layout(13, 13, "u4")


class EventArrayDecoder:
    """Decode dvs_msgs/EventArray; carries no state between messages."""

    def __init__(self, serialization: Serialization) -> None:
        self.statistics = Statistics()
        self._serialization = serialization
        self._layout = _CDR if serialization == "cdr" else _ROS1

    def decode(self, data: Bytes, part: int = 1) -> EventMessage:
        """Decode one message; see Decoder."""
        cursor = Cursor(data, self._serialization)
        header = cursor.header()
        height, width = cursor.integers("II")
        events = first_part(self._events(cursor), part)
        cursor.finish()
        return build_message(header, width, height, events, self.statistics)

    def resync(self, left_out: int) -> None:
        """Do nothing: there is no state."""

    def reset(self) -> None:
        """Do nothing: there is no state."""

    def _events(self, cursor: Cursor) -> Events:
        (count,) = cursor.integers("I")
        if count == 0:
            return Events.empty()
        cursor.align(_ALIGNMENT)
        layout = self._layout
        size = (count - 1) * layout.stride + _EVENT_SIZE
        if size > cursor.remaining:
            raise DecodeError(f"{count} events announced in {cursor.remaining} bytes")
        data = cursor.take(size)
        order = cursor.order
        address = np.dtype([("x", f"{order}u2"), ("y", f"{order}u2")])
        value = np.dtype([("s", f"{order}{layout.seconds}"), ("ns", f"{order}u4"), ("p", "u1")])
        stride = (layout.stride,)
        first: Structs = np.ndarray((1,), address, data)
        others: Structs = np.ndarray((count - 1,), address, data[layout.next :], strides=stride)
        values: Structs = np.ndarray((count,), value, data[address.itemsize :], strides=stride)

        x, y = np.empty(count, np.uint16), np.empty(count, np.uint16)
        x[:1], y[:1] = first["x"], first["y"]
        x[1:], y[1:] = others["x"], others["y"]
        t = values["s"].astype(np.int64)
        t *= NS_PER_S
        t += values["ns"]
        return Events(x, y, t, values["p"] != 0)


DECODER = EventArrayDecoder
