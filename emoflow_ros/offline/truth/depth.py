"""Flow maps from depth images and poses: the motion of a static scene."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.offline.truth.poses import PoseTrack


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
        """Tell nothing: depth images do not show what moves."""
        return None
