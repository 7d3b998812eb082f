"""Exact ground truth of a simulated recording: poses, twist, depth and flow at any time."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.simulation.raycast import RayCaster, exact_bearings
from emoflow_ros.simulation.scenes import Scene
from emoflow_ros.simulation.surfaces import MOVING
from emoflow_ros.simulation.trajectory import Pose

Image = NDArray[np.float64]


class GroundTruth:
    """What really happened. Times are ns; images are (H, W) on the camera's own pixel grid.

    Pixels whose ray the lens model does not define, or whose point is behind the camera at the
    second time, are NaN.

    Args:
        camera: the camera, lens included.
        scene: surfaces and motions.
        start: the time that the motions call zero, ns.
    """

    def __init__(self, camera: Camera, scene: Scene, start: int) -> None:
        self._camera = camera
        self._scene = scene
        self._caster = RayCaster(camera, scene.quads)
        self._start = start
        bearings = exact_bearings(camera)
        self._rays = np.concatenate([bearings, np.ones((*bearings.shape[:2], 1))], axis=-1)
        self._pixels = camera.project(self._rays)
        self._last: tuple[int, tuple[Image, NDArray[np.int64]]] | None = None

    def pose(self, t: int) -> NDArray[np.float64]:
        """World-from-camera transform, (4, 4), metres."""
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = self._scene.camera.pose(self._seconds(t))
        return transform

    def twist(self, t: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Linear (3,) m/s and angular (3,) rad/s velocity of the camera in its optical frame."""
        return self._scene.camera.twist(self._seconds(t))

    def acceleration(self, t: int) -> NDArray[np.float64]:
        """Acceleration (3,) m/s^2 of the camera's centre in the world's axes."""
        return self._scene.camera.acceleration(self._seconds(t))

    def depth(self, t: int) -> Image:
        """Depth along the optical axis, (H, W) m."""
        return self._cast(t)[0].copy()

    def moving_mask(self, t: int) -> NDArray[np.bool_]:
        """Pixels (H, W) that see an object that moves by itself."""
        return np.asarray(self._cast(t)[1] >= MOVING)

    def flow(self, t: int) -> Image:
        """Instantaneous motion field of the distorted image, (H, W, 2) px/s."""
        depth, body = self._cast(t)
        points = self._rays * depth[..., None]
        linear, angular = self.twist(t)
        velocity = -linear - np.cross(angular, points)
        for k in range(len(self._scene.movers)):
            on_mover = body == MOVING + k
            velocity[on_mover] += self._mover_velocity(k, t, points[on_mover])
        # d(X/Z)/dt, then through the lens.
        normalised = (velocity[..., :2] - self._rays[..., :2] * velocity[..., 2:]) / depth[
            ..., None
        ]
        _, lens = self._camera.distort(self._rays[..., :2])
        focal = (self._camera.fx, self._camera.fy)
        return np.asarray(np.einsum("...ij,...j->...i", lens, normalised) * focal)

    def displacement(self, t0: int, t1: int) -> Image:
        """Where the scene points that pixels see at t0 are at t1, minus the pixels: (H, W, 2)."""
        depth, body = self._cast(t0)
        points = self._rays * depth[..., None]
        moved = _transform(self._from_to(t0, t1), points)
        for k in range(len(self._scene.movers)):
            on_mover = body == MOVING + k
            moved[on_mover] = _transform(self._mover_from_to(k, t0, t1), points[on_mover])
        moved[moved[..., 2] <= 0] = np.nan
        return self._camera.project(moved) - self._pixels

    def rectified(self) -> "GroundTruth":
        """The same truth on the pixel grid of the camera without its lens distortion."""
        ideal = dataclasses.replace(self._camera, model="none", distortion=())
        return GroundTruth(ideal, self._scene, self._start)

    def _seconds(self, t: int) -> float:
        return (t - self._start) / NS_PER_S

    def _cast(self, t: int) -> tuple[Image, NDArray[np.int64]]:
        """Depth and bodies; several images of one time are usual, so the last cast is kept."""
        if self._last is None or self._last[0] != t:
            self._last = t, self._caster.cast(*self._scene.poses(self._seconds(t)))
        return self._last[1]

    def _mover_velocity(self, k: int, t: int, points: Image) -> Image:
        """Velocity of points (N, 3) on mover k against the world, in the camera's axes."""
        seconds = self._seconds(t)
        linear, angular = self._scene.movers[k].twist(seconds)
        rotation, position = self._in_camera(k, t)
        in_body = (points - position) @ rotation
        return np.asarray((linear + np.cross(angular, in_body)) @ rotation.T)

    def _in_camera(self, k: int, t: int) -> Pose:
        """Pose camera-from-mover of mover k."""
        (rotation, position), bodies = self._scene.poses(self._seconds(t))
        mover_rotation, mover_position = bodies[MOVING + k]
        return rotation.T @ mover_rotation, rotation.T @ (mover_position - position)

    def _from_to(self, t0: int, t1: int) -> NDArray[np.float64]:
        """Static points: camera at t1 from camera at t0, (4, 4)."""
        return np.asarray(np.linalg.inv(self.pose(t1)) @ self.pose(t0))

    def _mover_from_to(self, k: int, t0: int, t1: int) -> NDArray[np.float64]:
        """Points on mover k: camera at t1 from camera at t0, (4, 4)."""
        before, after = np.eye(4), np.eye(4)
        before[:3, :3], before[:3, 3] = self._in_camera(k, t0)
        after[:3, :3], after[:3, 3] = self._in_camera(k, t1)
        return np.asarray(after @ np.linalg.inv(before))


def _transform(transform: NDArray[np.float64], points: Image) -> Image:
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])
