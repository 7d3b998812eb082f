"""The unit of a column of times, which few files declare: one rule for every reader.

A recording has a plausible mean rate in one unit, or in two at most, since units are a factor of
1000 apart. `tell_unit` says how one of them is chosen.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.errors import InputError, say

S, MS, US, NS = NS_PER_S, NS_PER_MS, 1000, 1
_NAMES = {S: "seconds", MS: "milliseconds", US: "microseconds", NS: "nanoseconds"}
_WORDS = {
    "s": S, "sec": S, "second": S, "seconds": S,
    "ms": MS, "msec": MS, "millisecond": MS, "milliseconds": MS,
    "us": US, "usec": US, "µs": US, "microsecond": US, "microseconds": US,
    "ns": NS, "nsec": NS, "nanosecond": NS, "nanoseconds": NS,
}  # fmt: skip
TIME_UNITS = ("s", "ms", "us", "ns")
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
# Events per second, mean of a recording: of all that there are, of nearly all, and the most in
# nanoseconds that are whole microseconds.
_PLAUSIBLE = (1e3, 1e9)
_USUAL = (1e4, 1e8)
_MOST_OF_THOUSANDS = 3e7
_SLACK = 0.9  # the number of a text's lines is an estimate
_SAMPLE = 1000
END_VALUES = 9  # of which four may be out of order
_FEW = 1000  # events, too few to tell a rate
_PLAUSIBLE_FEW = (1.0, 1e9)
_HOUR_US = 3_600_000_000
_NS_BYTES = 8  # of a number that can hold nanoseconds
_INDEX_TOLERANCE = 10.0
_FIX = "say which unit t has with --time-unit s, ms, us or ns"


@dataclass(frozen=True)
class Clues:
    """What is known of a column of times.

    Attributes:
        path: the file, for errors.
        sample: (M,) its first and its last values, M > 0, as `sampled` reads them.
        count: how many values it has.
        declared: its unit in words, as the file or the user says it; empty where nobody does.
        milliseconds: the length of an index of milliseconds beside it; 0 without one.
        told: the order of the columns, where their values had to tell it.
        has_point: whether a text writes them with a decimal point, also where they are whole.
        of_format: nanoseconds of the unit that the file's format prescribes; None where it does
            not.
    """

    path: Path
    sample: NDArray[Any]
    count: int
    declared: str = ""
    milliseconds: int = 0
    told: str = ""
    has_point: bool = False
    of_format: int | None = None

    @property
    def ends(self) -> tuple[float, float]:
        """First and last value; of many events medians, since single ones may be out of order."""
        few = self._in_an_end
        return float(np.median(self.sample[:few])), float(np.median(self.sample[-few:]))

    @property
    def span(self) -> float:
        """Time between the two ends."""
        first, last = self.ends
        return last - first

    @property
    def _in_an_end(self) -> int:
        return END_VALUES if self.count >= _FEW else 1

    @property
    def is_whole(self) -> bool:
        """Whether all values are whole numbers, of whatever type, and written as such."""
        values = self.sample
        if self.has_point:
            return False
        if values.dtype.kind != "f":
            return True
        largest = np.abs(values).max()
        return bool((np.abs(values - np.rint(values)) <= 4 * np.spacing(largest)).all())

    @property
    def can_be_ns(self) -> bool:
        """Whether its type holds more than 4 s of nanoseconds."""
        return self.sample.dtype.itemsize >= _NS_BYTES

    def rate(self, unit: int) -> float:
        """Events per second in a unit; infinite where all have the same time."""
        between = self.count - self._in_an_end + 1
        return between * NS_PER_S / (self.span * unit) if self.span > 0 else np.inf


def sampled(read: Callable[[slice], NDArray[Any]], count: int) -> NDArray[Any]:
    """Read the first and the last 1000 of a column's values; all of them if they are few.

    Args:
        read: returns some of them.
        count: how many there are.
    """
    if count <= 2 * _SAMPLE:
        return read(slice(0, count))
    return np.concatenate([read(slice(0, _SAMPLE)), read(slice(count - _SAMPLE, count))])


def unit_of(word: str) -> int | None:
    """Return the nanoseconds of a unit by its name; None where it is not known."""
    return _WORDS.get(word.strip().lower())


def unit_name(unit: int) -> str:
    """Return the short name of a unit of so many nanoseconds."""
    return TIME_UNITS[(S, MS, US, NS).index(unit)]


def tell_unit(clues: Clues) -> int:
    """Return the nanoseconds of one unit of a column of times.

    What decides, in this order:

    1. What the file or the user declares.
    2. An index of milliseconds beside the column: its length is the recording's in milliseconds.
    3. Times since 1970: above 1e17 they are nanoseconds, above 1e14 microseconds.
    4. The unit that the format prescribes, if it gives 1e3 to 1e9 events per second.
    5. The only unit that gives a usual rate, 1e4 to 1e8; or, of several, the customary one: seconds
       if the values have decimals, else microseconds. Decimals are no nanoseconds, whole numbers
       no seconds, and 32-bit numbers no nanoseconds: they hold 4 s of them.
    6. Whole numbers that are 1e3 to 1e4 events per second in microseconds: nanoseconds, if all are
       thousands (event cameras count microseconds), else microseconds.
    7. Nanoseconds, if no unit gives a usual rate and microseconds would span more than an hour.

    In fewer than 1000 events a rate tells little: it is the customary unit, unless that gives less
    than one event per second or more than 1e9. A unit that is neither declared nor customary is
    said.

    Raises:
        InputError: an unknown unit, no unit with a plausible rate, or several and none of them
            customary.
    """
    if clues.declared:
        unit, is_certain = _declared(clues), True
    elif not np.isfinite(clues.sample).all():
        return S  # such times are refused where they are converted
    else:
        known = _from_index(clues) or _from_epoch(clues)
        unit = known or _from_rate(clues)
        is_certain = known is not None or _is_expected(clues, unit)
    said = [f"columns are taken as {clues.told}"] if clues.told else []
    if clues.told or not is_certain:
        said.append(f"t is taken as {_NAMES[unit]}, {_per_second(clues, unit)}")
        options = "--layout and --time-unit say" if clues.told else "--time-unit says"
        say(clues.path, f"{', '.join(said)}; {options} otherwise")
    return unit


def _declared(clues: Clues) -> int:
    unit = unit_of(clues.declared)
    if unit is None:
        raise InputError(clues.path, f"t has the unknown unit '{clues.declared}'", _FIX)
    return unit


def _from_index(clues: Clues) -> int | None:
    if clues.milliseconds == 0:
        return None
    # The index counts from t = 0 or from the first event.
    for length in (clues.span, clues.ends[1]):
        for unit in (NS, US, S):
            ratio = length * unit / (clues.milliseconds * MS)
            if 1 / _INDEX_TOLERANCE < ratio < _INDEX_TOLERANCE:
                return unit
    return None


def _from_epoch(clues: Clues) -> int | None:
    _, last = clues.ends
    if last >= _EPOCH_NS:
        return NS
    return US if last >= _EPOCH_US else None


def _customary(clues: Clues) -> tuple[int, ...]:
    """Return the units that values of this kind have, the customary one first."""
    if not clues.is_whole:
        return S, US, MS
    return (US, NS, MS) if clues.can_be_ns else (US, MS)


def _from_rate(clues: Clues) -> int:
    units = _customary(clues)
    customary = units[0]
    if clues.span <= 0:
        return clues.of_format or customary
    low, high = _PLAUSIBLE if clues.count >= _FEW else _PLAUSIBLE_FEW
    plausible = [unit for unit in units if low <= clues.rate(unit) <= high]
    if clues.of_format in units and _SLACK * low <= clues.rate(clues.of_format) <= high:
        return clues.of_format
    if clues.count < _FEW and plausible:
        return plausible[0]
    usual = [unit for unit in units if _is_usual(clues, unit)]
    if customary in usual:
        return customary
    if NS in units and _are_microseconds_in_ns(clues):
        return NS
    is_slow = customary in plausible and clues.rate(customary) < _USUAL[0]
    if is_slow and (clues.is_whole or MS not in usual):
        return customary
    if len(usual) == 1 and not is_slow:
        return usual[0]
    if not usual and NS in units and clues.span > _HOUR_US:
        return NS
    if plausible and not usual:
        return plausible[0]
    _refuse(clues, usual or list(units), is_slow)


def _is_expected(clues: Clues, unit: int) -> bool:
    """Whether a unit is the customary one, and its rate usual."""
    is_customary = unit == (clues.of_format or _customary(clues)[0])
    has_rate = clues.count >= _FEW and clues.span > 0
    return is_customary and (_is_usual(clues, unit) or not has_rate)


def _is_usual(clues: Clues, unit: int) -> bool:
    return _USUAL[0] <= clues.rate(unit) < _USUAL[1]


def _are_microseconds_in_ns(clues: Clues) -> bool:
    """Whether enough values, which differ, are whole thousands, at a rate that cameras reach."""
    values = clues.sample
    return (
        clues.rate(NS) <= _MOST_OF_THOUSANDS
        and len(np.unique(values)) >= 10
        and not (values % 1000).any()
    )


def _refuse(clues: Clues, units: list[int], is_slow: bool) -> NoReturn:
    units = [_customary(clues)[0], *units] if is_slow else units
    rates = ", ".join(f"{_per_second(clues, unit)} in {_NAMES[unit]}" for unit in units)
    count = int(float(f"{clues.count:.3g}"))  # of text it is an estimate
    raise InputError(clues.path, f"the unit of t cannot be told: {count} events are {rates}", _FIX)


def _per_second(clues: Clues, unit: int) -> str:
    rate = float(f"{clues.rate(unit):.2g}")
    number = f"{rate / 1e6:g} million" if rate >= 1e6 else f"{rate:g}"  # no exponent
    return f"{number} events per second"
