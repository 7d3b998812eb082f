"""Prophesee EVT 3.0: 16-bit words, each saying only what changed.

Source: https://docs.prophesee.ai/stable/data/encoding_formats/evt3.html. The type is in bits
12-15. Time is 24 bits of microseconds in two words and wraps every 16.8 s; rows, times and the
start of a vector hold until the next word of their kind, also across packets.
"""

import numpy as np
from numba import types

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics
from msg_adapters.packet_decoder import count_bits, expand, kernel_signature, run_kernel, view_words

ENCODING = "evt3"

_WORD = np.dtype("<u2")

_ADDR_Y = 0x0  # bits 0-10: row
_ADDR_X = 0x2  # bits 0-10: column, bit 11: polarity
_VECT_BASE_X = 0x3  # bits 0-10: column of the next vector's first pixel, bit 11: polarity
_VECT_12 = 0x4  # bit i: an event at base + i; the base advances by 12
_VECT_8 = 0x5  # the same with 8
_TIME_LOW = 0x6
_CONTINUED_4 = 0x7
_TIME_HIGH = 0x8
_PADDING = 0x9  # seen on Lucid cameras as 0x9999
_TRIGGER = 0xA
_OTHERS = 0xE
_CONTINUED_12 = 0xF

# Indices into the state.
_HIGH, _LOW, _ROW, _BASE, _ON, _KNOWN = range(6)
_STATE_SIZE = 6
# Bits of state[_KNOWN]: what has been seen since the start or the last gap.
_SEEN_HIGH, _SEEN_LOW, _SEEN_ROW, _SEEN_BASE = 1, 2, 4, 8
_ADDRESSABLE = _SEEN_HIGH | _SEEN_LOW | _SEEN_ROW

_WRAP_US = 1 << 24
# The high time of real sensors goes back at times without having wrapped. After a gap it may be
# any, so that only a small step back is no wrap.
_STEP_BACK_US = _WRAP_US // 2
_JITTER_US = 10 << 12
_MOST_AHEAD_US = _WRAP_US - _JITTER_US
_END_OF_ROW = np.int64(
    1 << 11
)  # columns have 11 bits; a vector beyond lies outside of every sensor


class PacketDecoder:
    """Decode EVT 3.0 packets."""

    def __init__(self, statistics: Statistics) -> None:
        self._statistics = statistics
        self._state = np.zeros(_STATE_SIZE, np.int64)

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; the sensor's time counts, `time_base` is not used."""
        words = view_words(payload, _WORD, big_endian, self._statistics)
        return run_kernel(_decode, words, self._state, _count(words), self._statistics)

    def resync(self) -> None:
        """Wait for time, row and vector base anew."""
        self._state[_KNOWN] = 0

    def reset(self) -> None:
        """Forget time and row."""
        self._state[:] = 0


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
        if kind == _ADDR_X:
            bits = np.int64(1)
        elif kind == _VECT_12:
            bits = word & 0xFFF
        elif kind == _VECT_8:
            bits = word & 0xFF
        count += count_bits(bits)
    return count


@njit(kernel_signature(types.uint16), nogil=True)
def _decode(words, state, x, y, t, p):  # type: ignore[no-untyped-def]
    high, low, row = state[_HIGH], state[_LOW], state[_ROW]
    base, on, known = state[_BASE], state[_ON], state[_KNOWN]
    n = triggers = wraps = skipped = 0
    most = _STEP_BACK_US if known & _SEEN_HIGH else _JITTER_US
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 12
        if kind == _ADDR_X:
            if known & _ADDRESSABLE == _ADDRESSABLE:
                x[n] = word & 0x7FF
                y[n] = row
                t[n] = (high | low) * 1000
                p[n] = word & 0x800 != 0
                n += 1
            else:
                skipped += 1
        elif kind in (_ADDR_Y, _TIME_LOW, _TIME_HIGH):
            # Their order is as good as random: selects cost less than mispredicted branches.
            last = high
            row = word & 0x7FF if kind == _ADDR_Y else row
            low = word & 0xFFF if kind == _TIME_LOW else low
            high = (last & -_WRAP_US) | (word & 0xFFF) << 12 if kind == _TIME_HIGH else last
            known |= _SEEN_ROW if kind == _ADDR_Y else 0
            known |= _SEEN_LOW if kind == _TIME_LOW and known & _SEEN_HIGH else 0
            known |= _SEEN_HIGH if kind == _TIME_HIGH else 0
            if abs(last - high) > most:
                is_wrap = last > high  # or jitter that steps back over one
                if is_wrap or (high - last > _MOST_AHEAD_US and last >= _WRAP_US):
                    high += _WRAP_US if is_wrap else -_WRAP_US
                    wraps += 1 if is_wrap else -1
            most = _STEP_BACK_US if kind == _TIME_HIGH else most
        elif kind == _VECT_BASE_X:
            base = word & 0x7FF
            on = word & 0x800
            known |= _SEEN_BASE
        elif kind in (_VECT_12, _VECT_8):
            width = 12 if kind == _VECT_12 else 8
            bits = word & ((1 << width) - 1)
            if known == _ADDRESSABLE | _SEEN_BASE:
                time = (high | low) * 1000
                n = expand(bits, base, row, time, on != 0, x, y, t, p, n)
            else:
                skipped += count_bits(bits)
            base = min(base + width, _END_OF_ROW)
        elif kind == _TRIGGER:
            triggers += 1
        elif kind not in (_OTHERS, _CONTINUED_4, _CONTINUED_12, _PADDING):
            skipped += 1
    state[_HIGH], state[_LOW], state[_ROW] = high, low, row
    state[_BASE], state[_ON], state[_KNOWN] = base, on, known
    return n, triggers, wraps, skipped


DECODER = PacketDecoder
