"""Cursors over the two serialisations: CDR (ROS 2, DDS-XTypes XCDR1) and ROS 1.

CDR: a 4-byte encapsulation (its second byte: 0 big, 1 little endian), then values aligned to
their size relative to the byte after it; strings carry their length with a closing NUL.
ROS 1: packed little endian; strings carry their length without a NUL.
"""

import struct
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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
