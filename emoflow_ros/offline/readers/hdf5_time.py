"""The unit of the column t of an HDF5 file, which few data sets declare.

What decides, in this order:

1. The attribute `unit` or `units` of the column: s, ms, us or ns, or their names.
2. An index of milliseconds beside it (`ms_to_idx`, `ms_map_idx`): its length is the recording's in
   milliseconds.
3. Times of day since 1970: above 1e17 they are nanoseconds, above 1e14 microseconds.
4. Floating-point values with at least one event per unit of time are seconds.
5. Of the others, nanoseconds are those that would span more than an hour as microseconds, and whole
   thousands (event cameras count microseconds) of at most 3e7 events per second; but no 32-bit
   integers, which hold 4 s of them.
6. Microseconds are those of at least 1000 events per second.

All else is refused.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError

_WORDS = {
    "s": NS_PER_S, "sec": NS_PER_S, "second": NS_PER_S, "seconds": NS_PER_S,
    "ms": NS_PER_MS, "millisecond": NS_PER_MS, "milliseconds": NS_PER_MS,
    "us": 1000, "usec": 1000, "µs": 1000, "microsecond": 1000, "microseconds": 1000,
    "ns": 1, "nsec": 1, "nanosecond": 1, "nanoseconds": 1,
}  # fmt: skip
_ATTRIBUTES = ("unit", "units")
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
_HOUR_US = 3_600_000_000
_MIN_RATE, _MAX_RATE = 1e3, 3e7  # events/s, mean of a recording
_BYTES = 8  # of a number that can hold nanoseconds
_TOLERANCE = 10.0  # units are a factor of 1000 apart
_FIX = "give the column t an attribute 'unit': s, us or ns"


@dataclass(frozen=True)
class Clues:
    """What is known of a column of times.

    Attributes:
        path: the file, for errors.
        attributes: of the column.
        sample: (M,) some of its values, M > 0; the first and the last one are the column's.
        count: how many values it has.
        milliseconds: the length of the index of milliseconds; 0 without one.
    """

    path: Path
    attributes: dict[str, Any]
    sample: NDArray[Any]
    count: int
    milliseconds: int = 0

    @property
    def span(self) -> float:
        """Last minus first value."""
        return float(self.sample[-1]) - float(self.sample[0])


def unit_ns(clues: Clues) -> int:
    """Return the nanoseconds of one unit of time.

    Raises:
        InputError: an unknown unit, or nothing that decides.
    """
    for decide in (_declared, _from_index, _from_epoch, _from_rate):
        unit = decide(clues)
        if unit is not None:
            return unit
    raise InputError(
        clues.path,
        f"the unit of t cannot be told: {clues.count} events over {clues.span:g} units",
        _FIX,
    )


def _declared(clues: Clues) -> int | None:
    for name in _ATTRIBUTES:
        if name in clues.attributes:
            word = clues.attributes[name]
            word = word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word)
            unit = _WORDS.get(word.strip().lower())
            if unit is None:
                raise InputError(clues.path, f"t has the unknown unit '{word}'", _FIX)
            return unit
    return None


def _from_index(clues: Clues) -> int | None:
    if clues.milliseconds == 0:
        return None
    # The index counts from t = 0 or from the first event.
    for length in (clues.span, float(clues.sample[-1])):
        for unit in (1, 1000, NS_PER_S):
            ratio = length * unit / (clues.milliseconds * NS_PER_MS)
            if 1 / _TOLERANCE < ratio < _TOLERANCE:
                return unit
    return None


def _from_epoch(clues: Clues) -> int | None:
    last = float(clues.sample[-1])
    if last >= _EPOCH_NS:
        return 1
    return 1000 if last >= _EPOCH_US else None


def _from_rate(clues: Clues) -> int | None:
    values, span = clues.sample, clues.span
    if values.dtype.kind == "f" and clues.count >= span:
        return NS_PER_S
    if values.dtype.itemsize == _BYTES and (
        span > _HOUR_US or (clues.count * 1e9 <= _MAX_RATE * span and _are_thousands(values))
    ):
        return 1
    return 1000 if clues.count * 1e6 >= _MIN_RATE * span else None


def _are_thousands(values: NDArray[Any]) -> bool:
    """Whether all of enough values, which differ, are whole thousands."""
    return len(np.unique(values)) >= 10 and not (values % 1000).any()
