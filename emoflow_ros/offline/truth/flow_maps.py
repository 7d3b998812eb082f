"""Displacement between any two times from a sequence of flow maps."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.offline.truth.base import TrueFlow

_KEPT_MAPS = 8


@dataclass(frozen=True)
class _Map:
    flow: NDArray[np.float32]
    moving: NDArray[np.bool_] | None


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

    def moving(self, index: int) -> NDArray[np.bool_] | None:
        """Pixels (H, W) of map `index` that see an object of its own motion; None if unknown."""
        ...


class PropagatedFlow:
    """Chain flow maps from t0 to t1, as the MVSEC benchmark does (Zhu et al., RSS 2018).

    Every pixel's position is carried through the maps by nearest-neighbour look-up, with the
    first and the last map scaled to the part of their interval that is used. A pixel that
    leaves the image or meets an unknown value has no truth. One that meets a moving object
    counts as moving.
    """

    def __init__(self, maps: FlowMaps) -> None:
        self._maps = maps
        self.stamps = maps.stamps
        self._kept: OrderedDict[int, _Map] = OrderedDict()
        self.description = f"flow: {maps.name}, propagated by nearest neighbour from map to map"

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Displacement over [t0, t1] ns; None outside the maps' stamps."""
        stamps = self.stamps
        if len(stamps) < 2 or not stamps[0] <= t0 < t1 <= stamps[-1]:
            return None
        first = int(np.searchsorted(stamps, t0, side="right")) - 1
        last = int(np.searchsorted(stamps, t1, side="left"))
        height, width = self._map(first).flow.shape[:2]
        start = np.indices((height, width), np.float64)[::-1].reshape(2, -1)
        at = start.copy()
        valid = np.ones(height * width, np.bool_)
        moving = np.zeros(height * width, np.bool_)
        for index in range(first, last):
            begin, end = int(stamps[index]), int(stamps[index + 1])
            share = (min(end, t1) - max(begin, t0)) / (end - begin)
            flow_map = self._map(index)
            step, known, on_mover = _look_up(flow_map, at)
            valid &= known
            moving |= on_mover
            at += share * step.astype(np.float64)
        moved = np.where(valid, at - start, 0).astype(np.float32).T.reshape(height, width, 2)
        told = flow_map.moving is not None
        valid, moving = valid.reshape(height, width), moving.reshape(height, width)
        return TrueFlow(moved, valid, moving if told else None)

    def _map(self, index: int) -> _Map:
        if index not in self._kept:
            self._kept[index] = _Map(self._maps.read(index), self._maps.moving(index))
            if len(self._kept) > _KEPT_MAPS:
                self._kept.popitem(last=False)
        return self._kept[index]


def _look_up(
    flow_map: _Map, at: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
    """Flow at the pixels nearest to `at`, both (2, N); where it is known, else it is zero.

    Returns:
        The flow, where it is known, and which of the pixels see a moving object.
    """
    height, width = flow_map.flow.shape[:2]
    column, row = np.rint(at).astype(np.int32)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    nearest = np.where(inside, row * width + column, 0)
    step = flow_map.flow.reshape(-1, 2).take(nearest, axis=0).T
    known = inside & np.isfinite(step[0]) & np.isfinite(step[1]) & ((step[0] != 0) | (step[1] != 0))
    if flow_map.moving is None:
        on_mover = np.zeros_like(inside)
    else:
        on_mover = inside & flow_map.moving.ravel()[nearest]
    return np.where(known, step, np.float32(0)), known, on_mover
