"""Columns of numbers as files hold them, converted to those of `Events`."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import NS_PER_S
from emoflow_ros.errors import InputError

_FURTHEST_NS = 9e18


def pixel_coordinates(values: NDArray[Any]) -> NDArray[np.uint16]:
    """Convert to the type of `Events`; what does not fit becomes its largest value: outside."""
    if values.dtype == np.uint16:
        return values
    largest = np.iinfo(np.uint16).max
    fits = (values >= 0) & (values < largest)
    return np.where(fits, values, largest).astype(np.uint16)


def times_ns(path: Path, t: NDArray[Any], unit: int = NS_PER_S) -> NDArray[np.int64]:
    """Convert times of any numeric type in units of so many ns.

    Raises:
        InputError: a time that is not finite, or further than centuries from zero.
    """
    with np.errstate(all="ignore"):
        ns = t.astype(np.float64) * unit
    if not (np.abs(ns) < _FURTHEST_NS).all():
        raise InputError(path, "event times that are not finite", "copy it again")
    if t.dtype.kind == "f":
        return np.rint(ns).astype(np.int64)
    return t.astype(np.int64) * unit
