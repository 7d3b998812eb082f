"""The compressed encoding of libcaer_driver: 16-bit words, columns first.

Source: libcaer_driver (ros-event-camera). The type is in bits 12-15. Each packet stands alone:
time starts at the packet's time_base and counts 24 bits of microseconds in two words.
"""

import numpy as np
from numba import types

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics
from msg_adapters.packet_decoder import count_bits, expand, kernel_signature, run_kernel, view_words

ENCODING = "libcaer_cmp"

_WORD = np.dtype("<u2")

_TIME_HIGH = 0x0
_TIME_LOW = 0x1
_ADDR_X = 0x2  # bits 0-10: column
_ADDR_Y = 0x3  # bits 0-10: row, bit 11: polarity; an event
_VECT_BASE_Y = 0x4  # bits 0-10: row of the next vector's first pixel, bit 11: polarity
_VECT_8 = 0x5  # bit i: an event at base + i; the base advances by 8

_WRAP_US = 1 << 24
_STEP_BACK_US = _WRAP_US // 2  # a smaller one is jitter
_JITTER_US = 10 << 12
_END_OF_COLUMN = np.int64(1 << 11)  # rows have 11 bits
_NOT_SEEN = -1


class PacketDecoder:
    """Decode libcaer_cmp packets; carries no state between them."""

    def __init__(self, statistics: Statistics) -> None:
        self._statistics = statistics

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; times count from `time_base`."""
        words = view_words(payload, _WORD, big_endian, self._statistics)
        state = np.array([time_base], np.int64)
        return run_kernel(_decode, words, state, _count(words), self._statistics)

    def resync(self) -> None:
        """Do nothing: packets stand alone."""

    def reset(self) -> None:
        """Do nothing: packets stand alone."""


@njit(
    types.int64(types.Array(types.uint16, 1, "C", readonly=True, aligned=False)),
    nogil=True,
)
def _count(words):  # type: ignore[no-untyped-def]
    """Count the events that the words can stand for at most."""
    count = 0
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 12
        bits = np.int64(0)
        if kind == _ADDR_Y:
            bits = np.int64(1)
        elif kind == _VECT_8:
            bits = word & 0xFF
        count += count_bits(bits)
    return count


@njit(kernel_signature(types.uint16), nogil=True)
def _decode(words, state, x, y, t, p):  # type: ignore[no-untyped-def]
    time_base = time = state[0]
    high = low = on = np.int64(0)
    column = base = np.int64(_NOT_SEEN)
    n = wraps = skipped = 0
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 12
        if kind == _VECT_8:
            if column != _NOT_SEEN and base != _NOT_SEEN:
                n = expand(word & 0xFF, base, column, time, on != 0, y, x, t, p, n)
                base = min(base + 8, _END_OF_COLUMN)
            else:
                skipped += count_bits(word & 0xFF)
        elif kind == _ADDR_Y:
            if column != _NOT_SEEN:
                x[n] = column
                y[n] = word & 0x7FF
                t[n] = time
                p[n] = word & 0x800 != 0
                n += 1
            else:
                skipped += 1
        elif kind == _ADDR_X:
            column = word & 0x7FF
        elif kind == _VECT_BASE_Y:
            base = word & 0x7FF
            on = word & 0x800
        elif kind == _TIME_LOW:
            low = word & 0xFFF
            time = time_base + (high | low) * 1000
        elif kind == _TIME_HIGH:
            last = high
            high = (last & -_WRAP_US) | (word & 0xFFF) << 12
            if last - high > _STEP_BACK_US:
                high += _WRAP_US
                wraps += 1
            elif high - last > _WRAP_US - _JITTER_US and last >= _WRAP_US:  # back over the wrap
                high -= _WRAP_US
                wraps -= 1
            time = time_base + (high | low) * 1000
        else:
            skipped += 1
    return n, 0, wraps, skipped


DECODER = PacketDecoder
