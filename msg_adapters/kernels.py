"""What the compiled kernels of the stateful encodings share.

A kernel takes the words of a packet, the state carried between packets and columns that are long
enough by construction, and returns how many events it wrote, the triggers and time wraps that it
saw, and the words or events that it had to skip. Signatures are explicit, so that importing a
kernel compiles it (or loads it from numba's cache) and no message ever waits for a compiler.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numba.core.typing.templates import Signature
from numpy.typing import NDArray

from emoflow_ros.core.events import Events
from msg_adapters.message import Statistics

type Kernel = Callable[..., tuple[int, int, int, int]]


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
    x, y = np.empty(capacity, np.uint16), np.empty(capacity, np.uint16)
    t, p = np.empty(capacity, np.int64), np.empty(capacity, np.bool_)
    count, triggers, wraps, skipped = kernel(words, state, x, y, t, p)
    statistics.triggers += triggers
    statistics.time_wraps += wraps
    statistics.skipped += skipped
    return Events(x[:count], y[:count], t[:count], p[:count])


@njit(nogil=True, cache=True)
def expand(bits, first, fixed, time, on, along, across, t, p, n):  # type: ignore[no-untyped-def]
    """Write one event for each set bit i at (first + i, fixed) from index n; return the next n.

    Unset bits are written too and then overwritten, which spares a branch. While a set bit is
    left there is room for it, so nothing is written past the events that were counted.
    """
    while bits:
        along[n] = first
        across[n] = fixed
        t[n] = time
        p[n] = on
        n += bits & 1
        first += 1
        bits >>= 1
    return n


@njit(nogil=True, cache=True)
def count_bits(bits):  # type: ignore[no-untyped-def]
    """Count the set bits."""
    count = 0
    while bits:
        count += 1
        bits &= bits - 1
    return count
