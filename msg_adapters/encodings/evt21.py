"""Prophesee EVT 2.1: 64-bit words, each with up to 32 events of one row, time and polarity.

Source: https://docs.prophesee.ai/stable/data/encoding_formats/evt21.html. The type is in bits
60-63. A vector holds the lowest 6 bits of its time in bits 54-59, the column of its first pixel
(a multiple of 32) in bits 43-53, its row in bits 32-42 and a mask of 32 pixels in bits 0-31;
TIME_HIGH the next 28 bits of time in bits 32-59. IMX636 sends the upper 32 bits of a word first
("legacy"), GenX320 the lower; neither says so in a packet, so that the words themselves must.
"""

import numpy as np
from numba import types
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics
from msg_adapters.packet_decoder import count_bits, expand, kernel_signature, run_kernel, view_words

ENCODING = "evt21"

_WORD = np.dtype("<i8")

_EVT_POS = 0x1  # EVT_NEG is 0
_TIME_HIGH = 0x8
_TRIGGER = 0xA
_OTHERS = 0xE
_CONTINUED = 0xF

_LOWER = 0xFFFFFFFF
_WRAP_US = 1 << 34
_JITTER_US = 10 << 12
_HIGH, _KNOWN = range(2)
_STATE_SIZE = 2


class PacketDecoder:
    """Decode EVT 2.1 packets."""

    def __init__(self, statistics: Statistics) -> None:
        self._statistics = statistics
        self._state = np.zeros(_STATE_SIZE, np.int64)
        self._upper_first: bool | None = None

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; the sensor's time counts, `time_base` is not used."""
        words = view_words(payload, _WORD, big_endian, self._statistics)
        if self._upper_first is None:
            self._upper_first = _find_order(words)
        if self._upper_first:
            words = _swap_halves(words)
        return run_kernel(_decode, words, self._state, _count(words), self._statistics)

    def resync(self) -> None:
        """Wait for time anew."""
        self._state[_KNOWN] = 0

    def reset(self) -> None:
        """Forget time and the order of the halves."""
        self._state[:] = 0
        self._upper_first = None


def _find_order(words: NDArray[np.int64]) -> bool | None:
    """Tell whether the upper half comes first; None while the words fit either order."""
    as_is, swapped = _plausible(words), _plausible(_swap_halves(words))
    return None if as_is == swapped else swapped > as_is


def _swap_halves(words: NDArray[np.int64]) -> NDArray[np.int64]:
    return words << 32 | words >> 32 & _LOWER


def _plausible(words: NDArray[np.int64]) -> int:
    """Count the words that are a time, or a vector with events and an aligned column."""
    kind = words >> 60 & 0xF
    aligned = words >> 43 & 0x1F == 0
    some = words & _LOWER != 0
    vectors = (kind <= _EVT_POS) & aligned & some
    times = (kind == _TIME_HIGH) & ~some
    return int(np.count_nonzero(vectors | times))


@njit(
    types.int64(types.Array(types.int64, 1, "C", readonly=True, aligned=False)),
    nogil=True,
)
def _count(words):  # type: ignore[no-untyped-def]
    """Count the events that the words can stand for at most."""
    count = 0
    for i in range(len(words)):
        if words[i] >> 60 & 0xF <= _EVT_POS:
            count += count_bits(words[i] & _LOWER)
    return count


@njit(kernel_signature(types.int64), nogil=True)
def _decode(words, state, x, y, t, p):  # type: ignore[no-untyped-def]
    high, known = state[_HIGH], state[_KNOWN]
    n = triggers = wraps = skipped = 0
    for i in range(len(words)):
        upper = words[i] >> 32 & _LOWER
        lower = words[i] & _LOWER
        kind = upper >> 28
        if kind <= _EVT_POS:
            if known:
                time = (high | upper >> 22 & 0x3F) * 1000
                on = kind == _EVT_POS
                n = expand(lower, upper >> 11 & 0x7FF, upper & 0x7FF, time, on, x, y, t, p, n)
            else:
                skipped += count_bits(lower)
        elif kind == _TIME_HIGH:
            last = high
            high = (last & -_WRAP_US) | (upper & 0xFFFFFFF) << 6
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
