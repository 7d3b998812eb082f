"""Cursors over the two serialisations: CDR (ROS 2, DDS-XTypes XCDR1) and ROS 1.

CDR: a 4-byte encapsulation (its second byte: 0 big, 1 little endian), then values aligned to
their size relative to the byte after it; strings carry their length with a closing NUL.
ROS 1: packed little endian; strings carry their length without a NUL.
"""

import struct
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

type Serialization = Literal["cdr", "ros1"]

NS_PER_S = 1_000_000_000
_ENCAPSULATION = 4
_STRUCTS = {order + code: struct.Struct(order + code) for order in "<>" for code in "BIiQ"}


class DecodeError(ValueError):
    """Bytes that are not a message of the expected type; says in one line why."""


@dataclass(frozen=True, slots=True)
class Header:
    """std_msgs/Header: stamp in ns, and the frame."""

    stamp: int
    frame_id: str


class Cursor:
    """Reads values one after another; every read is checked against the buffer's end.

    Args:
        data: the serialised message.
        serialization: `cdr` or `ros1`.

    Raises:
        DecodeError: not a contiguous run of bytes, or an unknown encapsulation.
    """

    def __init__(
        self, data: bytes | bytearray | memoryview | NDArray[np.uint8], serialization: Serialization
    ) -> None:
        view = memoryview(data)
        if not view.c_contiguous or view.itemsize != 1:
            raise DecodeError("the message is not a contiguous buffer of bytes")
        self._data = view.cast("B")
        self._cdr = serialization == "cdr"
        self._at = 0
        self.order: Literal["<", ">"] = "<"
        if self._cdr:
            kind = bytes(self.take(_ENCAPSULATION)[:2])
            if kind not in (b"\0\0", b"\0\1"):
                raise DecodeError(f"CDR encapsulation 0x{kind.hex()} is not plain CDR")
            self.order = ">" if kind == b"\0\0" else "<"

    @property
    def remaining(self) -> int:
        """Bytes left."""
        return len(self._data) - self._at

    def take(self, count: int) -> memoryview:
        """Take the next `count` bytes as a view."""
        if count > self.remaining:
            raise DecodeError(f"{count} bytes expected at byte {self._at}, {self.remaining} left")
        self._at += count
        return self._data[self._at - count : self._at]

    def align(self, size: int) -> None:
        """Skip CDR's padding before a value of `size` bytes."""
        if self._cdr:
            self.take((_ENCAPSULATION - self._at) % size)

    def scalar(self, code: Literal["B", "I", "i", "Q"]) -> int:
        """Read one integer, by its struct code."""
        packed = _STRUCTS[self.order + code]
        at = self._at
        if self._cdr:
            at += (_ENCAPSULATION - at) % packed.size
        if at + packed.size > len(self._data):
            raise DecodeError(f"the message ends at byte {len(self._data)}, inside a number")
        self._at = at + packed.size
        value: int = packed.unpack_from(self._data, at)[0]
        return value

    def string(self) -> str:
        """Read a string; bytes that are not UTF-8 are replaced."""
        raw = bytes(self.take(self.scalar("I")))
        if self._cdr:
            raw = raw.removesuffix(b"\0")
        return raw.decode(errors="replace")

    def blob(self) -> memoryview:
        """Read a sequence of bytes as a view."""
        return self.take(self.scalar("I"))

    def time(self) -> int:
        """Read a time as ns: int32 seconds in ROS 2, uint32 in ROS 1."""
        seconds = self.scalar("i" if self._cdr else "I")
        return seconds * NS_PER_S + self.scalar("I")

    def header(self) -> Header:
        """Read std_msgs/Header (ROS 1 has a sequence number before the stamp)."""
        if not self._cdr:
            self.scalar("I")
        return Header(self.time(), self.string())

    def finish(self) -> None:
        """Check that nothing but alignment's padding is left."""
        if self.remaining >= _ENCAPSULATION:
            raise DecodeError(f"{self.remaining} bytes left over after the message")
