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
        start = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        at = start.astype(np.float64)
        valid = np.ones((height, width), np.bool_)
        moving = np.zeros((height, width), np.bool_)
        for index in range(first, last):
            begin, end = int(stamps[index]), int(stamps[index + 1])
            share = (min(end, t1) - max(begin, t0)) / (end - begin)
            flow_map = self._map(index)
            step, known, on_mover = _look_up(flow_map, at)
            valid &= known
            moving |= on_mover
            at += share * step
        moved = np.where(valid[..., None], at - start, 0)
        told = flow_map.moving is not None
        return TrueFlow(moved.astype(np.float32), valid, moving if told else None)

    def _map(self, index: int) -> _Map:
        if index not in self._kept:
            self._kept[index] = _Map(self._maps.read(index), self._maps.moving(index))
            if len(self._kept) > _KEPT_MAPS:
                self._kept.popitem(last=False)
        return self._kept[index]


def _look_up(
    flow_map: _Map, at: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """Flow at the pixels nearest to `at`, both (H, W, 2); where it is known, else it is zero.

    Returns:
        The flow, where it is known, and which of the pixels see a moving object.
    """
    flow = flow_map.flow
    height, width = flow.shape[:2]
    column, row = (np.rint(at[..., i]).astype(np.intp) for i in (0, 1))
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    nearest = np.where(inside, row, 0), np.where(inside, column, 0)
    step = flow[nearest].astype(np.float64)
    known = inside & np.isfinite(step).all(axis=-1) & step.any(axis=-1)
    step[~known] = 0
    on_mover = np.zeros_like(inside) if flow_map.moving is None else flow_map.moving[nearest]
    return step, known, inside & on_mover
