"""What every decoder takes, returns, counts and raises, and the cursor that it reads messages with.

The cursor reads two serialisations: CDR (ROS 2, DDS-XTypes XCDR1) and ROS 1.
CDR: a 4-byte encapsulation (its second byte: 0 big, 1 little endian), then values aligned to
their size relative to the byte after it; strings carry their length with a closing NUL.
ROS 1: packed little endian; strings carry their length without a NUL.
"""

import struct
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numba import types
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events

type Bytes = bytes | bytearray | memoryview | NDArray[np.uint8]

_COORDINATES = types.Array(types.uint16, 1, "C", readonly=True)

type Serialization = Literal["cdr", "ros1"]

NS_PER_S = 1_000_000_000
_ENCAPSULATION = 4
_ORDERS: dict[bytes, Literal["<", ">"]] = {b"\0\0": ">", b"\0\1": "<"}
_CODES = ("B", "I", "II", "iII", "IIII", "QQ")
_STRUCTS = {order: {codes: struct.Struct(order + codes) for codes in _CODES} for order in "<>"}
# By byte order and codes: how to unpack, the size and the alignment.
_INTEGERS = {
    order: {codes: (s.unpack_from, s.size, s.size // len(codes)) for codes, s in structs.items()}
    for order, structs in _STRUCTS.items()
}


class EventMessage(NamedTuple):
    """The events of one message, in the order of the message.

    Attributes:
        events: the events inside the sensor; their times are the message's own (sensor time
            where the driver sends that), in ns.
        width, height: the sensor's size in pixels as the message gives it; 0 where it gives
            none, and then no event counts as outside.
        stamp: the header's stamp, ns.
        frame_id: the header's frame.
        seq: the packet's running number, where the type has one.
        dropped_outside: events outside the sensor's geometry, which are not in `events`.
    """

    events: Events
    width: int
    height: int
    stamp: int
    frame_id: str
    seq: int | None
    dropped_outside: int


@dataclass(slots=True)
class Statistics:
    """What a decoder has seen since it was made; `reset()` keeps it.

    Attributes:
        messages, events: decoded so far.
        dropped_outside: events outside the sensor's geometry.
        seq_gaps: messages missing by their running numbers.
        time_wraps: roll-overs of the sensor's clock.
        triggers: external trigger events, which are skipped.
        skipped: events before time or row was known, and words that mean nothing.
        encoding: of the last message, where the type has several; empty otherwise.
    """

    messages: int = 0
    events: int = 0
    dropped_outside: int = 0
    seq_gaps: int = 0
    time_wraps: int = 0
    triggers: int = 0
    skipped: int = 0
    encoding: str = ""


class Decoder(Protocol):
    """Decodes the messages of one topic in order; several topics need several decoders."""

    statistics: Statistics

    def decode(self, data: Bytes, part: int = 1) -> EventMessage:
        """Decode one serialised message. `data` may be reused by the caller afterwards.

        Args:
            data: the message.
            part: n decodes the first n-th of the events only, of a packet the first n-th of its
                bytes; the rest is left out.

        Raises:
            DecodeError: the bytes are not a message of this type. The decoder stays usable.
        """
        ...

    def resync(self, left_out: int) -> None:
        """Expect a gap before the next message: the caller has left out so many."""
        ...

    def reset(self) -> None:
        """Forget the state carried between messages, for example on a jump in time."""
        ...


def build_message(
    header: tuple[int, str],
    width: int,
    height: int,
    events: Events,
    statistics: Statistics,
    *,
    seq: int | None = None,
    dropped: int = 0,
) -> EventMessage:
    """Drop and count the events outside width x height (0: unknown), and add up statistics.

    `dropped` events of the message have been left out as outside before.
    """
    count = len(events)
    # Two maxima cost less than a mask; the mask is for the rare stream that needs it.
    if width and height and _any_outside(events.x, events.y, width, height):
        events = events[events.inside(width, height)]
        dropped += count - len(events)
        count = len(events)
    statistics.messages += 1
    statistics.events += count
    statistics.dropped_outside += dropped
    return EventMessage(events, width, height, *header, seq, dropped)


def first_part(events: Events, part: int) -> Events:
    """Return the first 1/part of the events, one at least if there are any."""
    return events if part == 1 else events[: -(-len(events) // part)]


@njit(types.boolean(_COORDINATES, _COORDINATES, types.int64, types.int64), nogil=True)
def _any_outside(x, y, width, height):  # type: ignore[no-untyped-def]
    """Whether any of the coordinates x, y (N,) uint16 lies outside width x height pixels."""
    x_max = y_max = np.uint16(0)
    for i in range(len(x)):
        x_max = max(x_max, x[i])
        y_max = max(y_max, y[i])
    return x_max >= width or y_max >= height


class DecodeError(ValueError):
    """Bytes that are not a message of the expected type; says in one line why."""


class Cursor:
    """Reads values one after another; every read is checked against the buffer's end.

    Args:
        data: the serialised message.
        serialization: `cdr` or `ros1`.

    Raises:
        DecodeError: not a contiguous run of bytes, or an unknown encapsulation.
    """

    __slots__ = ("_at", "_cdr", "_data", "_end", "_integers", "order")

    def __init__(
        self, data: bytes | bytearray | memoryview | NDArray[np.uint8], serialization: Serialization
    ) -> None:
        view = memoryview(data)
        if not view.c_contiguous or view.itemsize != 1:
            raise DecodeError("the message is not a contiguous buffer of bytes")
        self._data = view.cast("B")
        self._end = len(self._data)
        self._cdr = serialization == "cdr"
        self._at = 0
        self.order: Literal["<", ">"] = "<"
        if self._cdr:
            kind = bytes(self._data[:2])
            if kind not in _ORDERS:
                raise DecodeError(f"CDR encapsulation 0x{kind.hex()} is not plain CDR")
            self.order = _ORDERS[kind]
            self._at = _ENCAPSULATION
        self._integers = _INTEGERS[self.order]

    @property
    def remaining(self) -> int:
        """Bytes left."""
        return self._end - self._at

    def take(self, count: int) -> memoryview:
        """Take the next `count` bytes as a view."""
        at = self._at
        if at + count > self._end:
            raise DecodeError(f"{count} bytes expected at byte {at}, {self.remaining} left")
        self._at = at + count
        return self._data[at : at + count]

    def align(self, size: int) -> None:
        """Skip CDR's padding before a value of `size` bytes."""
        if self._cdr:
            self.take((_ENCAPSULATION - self._at) % size)

    def integers(self, codes: str) -> tuple[int, ...]:
        """Read integers of one size that follow each other, by their struct codes."""
        unpack, size, alignment = self._integers[codes]
        at = self._at
        if self._cdr:
            at += (_ENCAPSULATION - at) % alignment
        if at + size > self._end:
            raise DecodeError(f"the message ends at byte {self._end}, inside a number")
        self._at = at + size
        return unpack(self._data, at)

    def string(self) -> str:
        """Read a string; bytes that are not UTF-8 are replaced."""
        (length,) = self.integers("I")
        return self._text(length)

    def blob(self) -> memoryview:
        """Read a sequence of bytes as a view."""
        (length,) = self.integers("I")
        return self.take(length)

    def header(self) -> tuple[int, str]:
        """Read std_msgs/Header as (stamp in ns, frame_id).

        In ROS 1 a running number comes before the stamp, whose seconds are unsigned.
        """
        if self._cdr:
            seconds, nanoseconds, length = self.integers("iII")
        else:
            _, seconds, nanoseconds, length = self.integers("IIII")
        return seconds * NS_PER_S + nanoseconds, self._text(length)

    def finish(self) -> None:
        """Check that nothing but alignment's padding is left."""
        if self._end - self._at >= _ENCAPSULATION:
            raise DecodeError(f"{self.remaining} bytes left over after the message")

    def _text(self, length: int) -> str:
        text = str(self.take(length), errors="replace")
        return text.removesuffix("\0") if self._cdr else text
