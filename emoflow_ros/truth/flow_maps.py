"""True flow from flow maps or from depth images and poses, and the parts of it that count."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.readers.stamps import distinct
from emoflow_ros.truth.flow_kernels import carry
from emoflow_ros.truth.ground_truth import FlowSource, PoseTrack, TrueFlow

_KEPT_MAPS = 8


@dataclass(frozen=True)
class _Map:
    flow: NDArray[np.float32]
    moving: NDArray[np.bool_] | None

    @cached_property
    def mover(self) -> NDArray[np.bool_]:
        """Pixels that are known to see a moving object."""
        return np.zeros(self.flow.shape[:2], np.bool_) if self.moving is None else self.moving


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

    Args:
        maps: the flow maps.
        published: follow the benchmark's code in intervals shorter than the map that they begin
            in, too: it scales this one map, even where the interval reaches into the next one.
    """

    def __init__(self, maps: FlowMaps, *, published: bool = False) -> None:
        self._maps = maps
        self._published = published
        # Of two maps with one stamp the last one leads to the next stamp.
        self._indices = distinct(maps.name, maps.stamps, keep_last=True)
        self.stamps = maps.stamps[self._indices]
        self._kept: OrderedDict[int, _Map] = OrderedDict()
        self.description = f"flow: {maps.name}, propagated by nearest neighbour from map to map"
        if published:
            self.description += "; the first map alone, scaled, in intervals shorter than it"

    def as_published(self) -> "PropagatedFlow":
        """Return the same truth by the rule of the benchmark's code."""
        return PropagatedFlow(self._maps, published=True)

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Displacement over [t0, t1] ns; None outside the maps' stamps."""
        stamps = self.stamps
        if len(stamps) < 2 or not stamps[0] <= t0 < t1 <= stamps[-1]:
            return None
        first = int(np.searchsorted(stamps, t0, side="right")) - 1
        last = int(np.searchsorted(stamps, t1, side="left"))
        if self._published and t1 - t0 < stamps[first + 1] - stamps[first]:
            last = first + 1
        height, width = self._map(first).flow.shape[:2]
        moved = np.zeros((height, width, 2))
        valid = np.ones((height, width), np.bool_)
        moving = np.zeros((height, width), np.bool_)
        for index in range(first, last):
            begin, end = int(stamps[index]), int(stamps[index + 1])
            # The whole interval, where one map stands for it.
            part = t1 - t0 if last == first + 1 else min(end, t1) - max(begin, t0)
            share = part / (end - begin)
            flow_map = self._map(index)
            carry(flow_map.flow, flow_map.mover, share, moved, valid, moving)
        moved[~valid] = 0
        told = flow_map.moving is not None
        return TrueFlow(moved.astype(np.float32), valid, moving if told else None)

    def _map(self, index: int) -> _Map:
        if index not in self._kept:
            read = int(self._indices[index])
            self._kept[index] = _Map(self._maps.read(read), self._maps.moving(read))
            if len(self._kept) > _KEPT_MAPS:
                self._kept.popitem(last=False)
        return self._kept[index]


class DepthFlowMaps:
    """Displacement from each depth image to the next one, on the event camera's pixel grid.

    Args:
        camera: the event camera, whose (distorted) pixels the depth images cover.
        track: its poses.
        stamps: (N,) int64 ns, of the depth images.
        read_depth: gives depth image i, (H, W) m along the optical axis, NaN where unknown.
        name: where they come from.
    """

    def __init__(
        self,
        camera: Camera,
        track: PoseTrack,
        stamps: NDArray[np.int64],
        read_depth: Callable[[int], NDArray[np.float32]],
        name: str,
    ) -> None:
        covered = [track.covers(int(t)) for t in stamps]
        self.stamps = stamps[covered]
        self.name = f"{name}, moved by the poses (static scene)"
        self._indices = np.flatnonzero(covered)
        self._read_depth = read_depth
        self._track = track
        self._camera = camera
        self._grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
        ones = np.ones((camera.height, camera.width, 1))
        self._rays = np.concatenate([camera.bearings.astype(np.float64), ones], axis=-1)

    def read(self, index: int) -> NDArray[np.float32]:
        """Map `index`, (H, W, 2) px; NaN where depth is unknown or the point ends up behind."""
        depth = self._read_depth(int(self._indices[index])).astype(np.float64)
        world_from_0, world_from_1 = (
            self._track.transform(int(t)) for t in self.stamps[index : index + 2]
        )
        motion = np.linalg.inv(world_from_1) @ world_from_0
        points = self._rays * depth[..., None] @ motion[:3, :3].T + motion[:3, 3]
        points[~(points[..., 2] > 0)] = np.nan
        with np.errstate(invalid="ignore"):
            flow = self._camera.project(points) - self._grid
        return flow.astype(np.float32)

    def moving(self, index: int) -> NDArray[np.bool_] | None:
        """Return None: depth images do not show what moves."""
        return None


class CroppedFlow:
    """True flow of which only the upper rows count."""

    def __init__(self, source: FlowSource, rows: int) -> None:
        self._source = source
        self._rows = rows
        self.description = source.description

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Return the source's displacement, not valid from row `rows` on."""
        flow = self._source.displacement(t0, t1)
        if flow is None:
            return None
        valid = flow.valid.copy()
        valid[self._rows :] = False
        return replace(flow, valid=valid)


class ListedFlow:
    """True flow of which only given intervals (start, end) in ns count, no others."""

    def __init__(self, source: FlowSource, intervals: Sequence[tuple[int, int]]) -> None:
        self._source = source
        self._intervals = frozenset(intervals)
        self.description = source.description

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Return the source's displacement over a given interval; None over others."""
        return self._source.displacement(t0, t1) if (t0, t1) in self._intervals else None
