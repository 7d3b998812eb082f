"""Event arrays: the one representation that every part of the package passes on."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Events:
    """Events of one sensor as columns of equal length N, in order of arrival.

    Attributes:
        x: (N,) uint16, pixel column.
        y: (N,) uint16, pixel row.
        t: (N,) int64, time in nanoseconds.
        p: (N,) bool, polarity (True = ON, brighter).
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    t: NDArray[np.int64]
    p: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, index: slice | NDArray[np.bool_] | NDArray[np.intp]) -> "Events":
        """Select events by slice (views), mask or indices (copies)."""
        return Events(self.x[index], self.y[index], self.t[index], self.p[index])

    @staticmethod
    def empty() -> "Events":
        """No events."""
        return Events(
            np.empty(0, np.uint16),
            np.empty(0, np.uint16),
            np.empty(0, np.int64),
            np.empty(0, np.bool_),
        )

    @staticmethod
    def concatenate(parts: Sequence["Events"]) -> "Events":
        """Join parts in the order given."""
        if not parts:
            return Events.empty()
        if len(parts) == 1:
            return parts[0]
        return Events(
            np.concatenate([e.x for e in parts]),
            np.concatenate([e.y for e in parts]),
            np.concatenate([e.t for e in parts]),
            np.concatenate([e.p for e in parts]),
        )

    def inside(self, width: int, height: int) -> NDArray[np.bool_]:
        """Mask (N,) of the events that lie on a sensor of width x height pixels."""
        return (self.x < width) & (self.y < height)
