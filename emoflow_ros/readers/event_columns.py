"""Columns of numbers as files hold them, converted to those of `Events`."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError

_FURTHEST_NS = 9e18
_CLOCK_NS = 1000  # of event cameras


def pixel_coordinates(values: NDArray[Any]) -> NDArray[np.uint16]:
    """Convert to the type of `Events`; what does not fit becomes its largest value: outside."""
    if values.dtype == np.uint16:
        return values
    largest = np.iinfo(np.uint16).max
    fits = (values >= 0) & (values < largest)
    return np.where(fits, values, largest).astype(np.uint16)


def times_ns(path: Path, t: NDArray[Any], unit: int = NS_PER_S) -> NDArray[np.int64]:
    """Convert times of any numeric type in units of so many ns.

    Numbers with decimals are coarse far from zero: seconds since 1970 have steps of 240 ns. Where
    all are whole microseconds but for that, as event cameras count, they become these.

    Raises:
        InputError: a time that is not finite, or further than centuries from zero.
    """
    with np.errstate(all="ignore"):
        ns = t.astype(np.float64) * unit
    if not (np.abs(ns) < _FURTHEST_NS).all():
        raise InputError(path, "event times that are not finite", "copy it again")
    if t.dtype.kind == "f":
        counted = _as_counted(t, unit)
        return np.rint(ns).astype(np.int64) if counted is None else counted
    return t.astype(np.int64) * unit


def _as_counted(t: NDArray[Any], unit: int) -> NDArray[np.int64] | None:
    """Return times in ns without what the steps of their type have made of whole microseconds.

    None where the type is fine enough, or they are not whole microseconds.
    """
    step_ns = float(np.spacing(np.abs(t).max())) * unit if np.size(t) else 0.0
    if step_ns <= 1:
        return None
    us = t.astype(np.float64) * (unit / _CLOCK_NS)
    counted = np.rint(us)
    if (np.abs(us - counted) > step_ns / _CLOCK_NS).any():
        return None
    whole: NDArray[np.int64] = counted.astype(np.int64) * _CLOCK_NS
    return whole
