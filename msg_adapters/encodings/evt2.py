"""Prophesee EVT 2.0: one 32-bit word per event, with time's upper bits in words of their own.

Source: https://docs.prophesee.ai/stable/data/encoding_formats/evt2.html. The type is in bits
28-31. An event holds the lowest 6 bits of its time in bits 22-27, its column in bits 11-21 and
its row in bits 0-10; TIME_HIGH the next 28 bits. 34 bits of microseconds wrap every 4.8 hours.
"""

import numpy as np
from numba import types

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics
from msg_adapters.packet_decoder import kernel_signature, run_kernel, view_words

ENCODING = "evt2"

_WORD = np.dtype("<u4")

_CD_ON = 0x1  # CD_OFF is 0
_TIME_HIGH = 0x8
_TRIGGER = 0xA
_OTHERS = 0xE
_CONTINUED = 0xF

_FIRST_NOT_CD = np.uint32((_CD_ON + 1) << 28)
_WRAP_US = 1 << 34
_JITTER_US = 10 << 12
_HIGH, _KNOWN = range(2)
_STATE_SIZE = 2


class PacketDecoder:
    """Decode EVT 2.0 packets."""

    def __init__(self, statistics: Statistics) -> None:
        self._statistics = statistics
        self._state = np.zeros(_STATE_SIZE, np.int64)

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; the sensor's time counts, `time_base` is not used."""
        words = view_words(payload, _WORD, big_endian, self._statistics)
        capacity = int(np.count_nonzero(words < _FIRST_NOT_CD))
        return run_kernel(_decode, words, self._state, capacity, self._statistics)

    def resync(self) -> None:
        """Wait for time anew."""
        self._state[_KNOWN] = 0

    def reset(self) -> None:
        """Forget time."""
        self._state[:] = 0


@njit(kernel_signature(types.uint32), nogil=True)
def _decode(words, state, x, y, t, p):  # type: ignore[no-untyped-def]
    high, known = state[_HIGH], state[_KNOWN]
    n = triggers = wraps = skipped = 0
    for i in range(len(words)):
        word = np.int64(words[i])
        kind = word >> 28
        if kind <= _CD_ON:
            if known:
                x[n] = word >> 11 & 0x7FF
                y[n] = word & 0x7FF
                t[n] = (high | word >> 22 & 0x3F) * 1000
                p[n] = kind == _CD_ON
                n += 1
            else:
                skipped += 1
        elif kind == _TIME_HIGH:
            last = high
            high = (last & -_WRAP_US) | (word & 0xFFFFFFF) << 6
            if last - high > _WRAP_US // 2:
                high += _WRAP_US
                wraps += 1
            elif high - last > _WRAP_US - _JITTER_US and last >= _WRAP_US:  # back over the wrap
                high -= _WRAP_US
                wraps -= 1
            known = 1
        elif kind == _TRIGGER:
            triggers += 1
        elif kind != _OTHERS and kind != _CONTINUED:
            skipped += 1
    state[_HIGH], state[_KNOWN] = high, known
    return n, triggers, wraps, skipped


DECODER = PacketDecoder
