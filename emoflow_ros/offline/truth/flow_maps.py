"""Displacement between any two times from a sequence of flow maps."""

from collections import OrderedDict
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.offline.truth.base import TrueFlow

_KEPT_MAPS = 8


class FlowMaps(Protocol):
    """Flow maps, each over the interval to the next stamp.

    Attributes:
        stamps: (N,) int64 ns, increasing; the last map's interval has no end, so it is not used.
        name: where the maps come from.
    """

    stamps: NDArray[np.int64]
    name: str

    def read(self, index: int) -> NDArray[np.float32]:
        """Map `index`, (H, W, 2) px displacement to the next stamp; NaN or 0 where unknown."""
        ...


class PropagatedFlow:
    """Chain flow maps from t0 to t1, as the MVSEC benchmark does (Zhu et al., RSS 2018).

    Every pixel's position is carried through the maps by nearest-neighbour look-up, with the
    first and the last map scaled to the part of their interval that is used. A pixel that
    leaves the image or meets an unknown value has no truth.
    """

    def __init__(self, maps: FlowMaps) -> None:
        self._maps = maps
        self.stamps = maps.stamps
        self._kept: OrderedDict[int, NDArray[np.float32]] = OrderedDict()
        self.description = f"flow: {maps.name}, propagated by nearest neighbour from map to map"

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Displacement over [t0, t1] ns; None outside the maps' stamps."""
        stamps = self.stamps
        if len(stamps) < 2 or not stamps[0] <= t0 < t1 <= stamps[-1]:
            return None
        first = int(np.searchsorted(stamps, t0, side="right")) - 1
        last = int(np.searchsorted(stamps, t1, side="left"))
        height, width = self._map(first).shape[:2]
        start = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        at = start.astype(np.float64)
        valid = np.ones((height, width), np.bool_)
        for index in range(first, last):
            begin, end = int(stamps[index]), int(stamps[index + 1])
            share = (min(end, t1) - max(begin, t0)) / (end - begin)
            step, known = _look_up(self._map(index), at)
            valid &= known
            at += share * step
        moved = np.where(valid[..., None], at - start, 0)
        return TrueFlow(moved.astype(np.float32), valid)

    def _map(self, index: int) -> NDArray[np.float32]:
        if index not in self._kept:
            self._kept[index] = self._maps.read(index)
            if len(self._kept) > _KEPT_MAPS:
                self._kept.popitem(last=False)
        return self._kept[index]


def _look_up(
    flow: NDArray[np.float32], at: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Flow at the pixels nearest to `at`, both (H, W, 2), and where it is known; else zero."""
    height, width = flow.shape[:2]
    column, row = (np.rint(at[..., i]).astype(np.intp) for i in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    step = flow[np.where(inside, row, 0), np.where(inside, column, 0)].astype(np.float64)
    known = inside & np.isfinite(step).all(axis=-1) & step.any(axis=-1)
    step[~known] = 0
    return step, known
