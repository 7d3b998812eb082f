"""What the decoders of EventPacket's encodings share: interface, view of words, kernels.

A kernel is the compiled decoder of a stateful encoding. It takes the words of a packet, the state
carried between packets and columns that are long enough by construction. It returns how many
events it wrote, the triggers and time wraps that it saw, and the words or events that it skipped.

Signatures are explicit, so that importing a kernel compiles it (or loads it from disk) and no
message waits for a compiler.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numba import types
from numba.core.typing.templates import Signature
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events
from msg_adapters.message import Statistics

# np.empty takes longer over a type than over its dtype.
_COORDINATE, _TIME, _POLARITY = np.dtype(np.uint16), np.dtype(np.int64), np.dtype(np.bool_)

type Kernel = Callable[..., tuple[int, int, int, int]]


class PacketDecoder(Protocol):
    """Decodes the payloads of one stream in order; adds to the statistics it was made with."""

    def __init__(self, statistics: Statistics) -> None: ...

    def decode(self, payload: memoryview, big_endian: bool, time_base: int) -> Events:
        """Decode one packet; `time_base` is in ns and below 2**62. Never fails."""
        ...

    def resync(self) -> None:
        """Forget the state that lost packets may have changed; keep counting time wraps."""
        ...

    def reset(self) -> None:
        """Forget everything."""
        ...


def view_words(
    payload: memoryview, word: np.dtype[Any], big_endian: bool, statistics: Statistics
) -> NDArray[Any]:
    """View a payload as words of a little-endian type; big-endian ones are copied.

    An incomplete word at the end counts as skipped.
    """
    if len(payload) % word.itemsize:
        statistics.skipped += 1
    words: NDArray[Any] = np.ndarray(len(payload) // word.itemsize, word, payload)
    return words.byteswap() if big_endian else words


def kernel_signature(word: types.Type) -> Signature:
    """Return the numba signature (words, state, x, y, t, p) -> (events, triggers, wraps, skipped).

    Words may start at any byte of a message, hence not aligned.
    """
    words = types.Array(word, 1, "C", readonly=True, aligned=False)
    columns = (types.uint16[::1], types.uint16[::1], types.int64[::1], types.boolean[::1])
    return types.UniTuple(types.int64, 4)(words, types.int64[::1], *columns)


def run_kernel(
    kernel: Kernel,
    words: NDArray[Any],
    state: NDArray[np.int64],
    capacity: int,
    statistics: Statistics,
) -> Events:
    """Decode words into at most `capacity` events and add up the statistics."""
    x, y = np.empty(capacity, _COORDINATE), np.empty(capacity, _COORDINATE)
    t, p = np.empty(capacity, _TIME), np.empty(capacity, _POLARITY)
    count, triggers, wraps, skipped = kernel(words, state, x, y, t, p)
    statistics.triggers += triggers
    statistics.time_wraps += wraps
    statistics.skipped += skipped
    events = Events(x, y, t, p)
    return events if count == capacity else events[:count]


@njit(inline="always")
def count_bits(bits):  # type: ignore[no-untyped-def]
    """Count the set bits of a 32-bit word, without a branch: sums of 2, 4, 8 bits and of bytes."""
    pairs = bits - (bits >> 1 & 0x55555555)
    nibbles = (pairs & 0x33333333) + (pairs >> 2 & 0x33333333)
    octets = nibbles + (nibbles >> 4) & 0x0F0F0F0F
    return (octets * 0x01010101 & 0xFFFFFFFF) >> 24


@njit(inline="always")
def expand(bits, first, fixed, time, on, along, across, t, p, n):  # type: ignore[no-untyped-def]
    """Write one event for each set bit i at (first + i, fixed) from index n; return the next n."""
    while bits:
        along[n] = first + count_bits((bits & -bits) - 1)  # bits below the lowest set one
        across[n] = fixed
        t[n] = time
        p[n] = on
        n += 1
        bits &= bits - 1
    return n
