"""True motion of pixels by rotation alone, and of recordings whose depth nobody measured."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.truth import TrueFlow, Truth, TwistSource

_STEP_NS = 4_000_000


def relative_pose(
    twists: TwistSource, t0: int, t1: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Integrate true velocities from t0 to t1 (ns).

    Returns:
        Rotation (3, 3) and position (3,) of the camera at t1 in its frame at t0, in steps of at
        most 4 ms; the translation is zero where the source tells none. Steps without truth take
        the mean velocity of the others; None without truth at any.
    """
    steps = max(1, math.ceil((t1 - t0) / _STEP_NS))
    seconds = (t1 - t0) / NS_PER_S / steps
    velocities = np.full((steps, 6), np.nan)
    for k in range(steps):
        twist = twists.twist(t0 + round((k + 0.5) * (t1 - t0) / steps))
        if twist is not None:
            linear = np.zeros(3) if twist.linear is None else twist.linear
            velocities[k] = *linear, *twist.angular
    known = np.isfinite(velocities).all(axis=1)
    if not known.any():
        return None
    velocities[~known] = velocities[known].mean(axis=0)
    rotation, position = np.eye(3), np.zeros(3)
    for linear, angular in zip(velocities[:, :3], velocities[:, 3:], strict=True):
        middle = Rotation.from_rotvec(angular * seconds / 2).as_matrix()
        position = position + rotation @ middle @ linear * seconds
        rotation = rotation @ middle @ middle
    return rotation, position


def true_rotation(truth: Truth, t0: int, t1: int) -> NDArray[np.float64] | None:
    """Rotation (3, 3) of the camera at t1 in its frame at t0 (ns): from poses, else velocities.

    None where neither is known.
    """
    poses = truth.poses
    if poses is not None and poses.covers(t0) and poses.covers(t1):
        return poses.transform(t0)[:3, :3].T @ poses.transform(t1)[:3, :3]
    pose = relative_pose(truth.twists, t0, t1) if truth.twists else None
    return pose[0] if pose else None


def displace(
    camera: Camera,
    pixels: NDArray[np.intp],
    rotation: NDArray[np.float64],
    position: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Displacement of pixels when the camera takes a new pose.

    Args:
        camera: the true camera.
        pixels: (N, 2) columns and rows.
        rotation, position: of the new pose in the old one, (3, 3) and (3,), the position over the
            depth of the scene; zero for rotation alone.

    Returns:
        (N, 2) px; NaN where the point is behind the camera then.
    """
    bearings = camera.bearings[pixels[:, 1], pixels[:, 0]].astype(np.float64)
    rays = np.concatenate([bearings, np.ones((len(bearings), 1))], axis=1)
    moved = (rays - position) @ rotation  # rows times R = R^T times columns
    with np.errstate(invalid="ignore", divide="ignore"):
        flow = camera.project(moved) - camera.project(rays)
    return np.where(moved[:, 2:] > 0, flow, np.nan)


class NominalFlow:
    """Displacement as if the whole scene had one depth: tells how far, not exactly where.

    Args:
        twists: true velocities; a gyro's tell no translation, and the depth does not matter then.
        camera: the camera.
        depth: of the scene, m.
    """

    def __init__(self, twists: TwistSource, camera: Camera, depth: float) -> None:
        self._twists = twists
        self._camera = camera
        self._depth = depth
        self.description = f"flow: velocities of {twists.name} and a plane at {depth:g} m"

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Displacement of every pixel from t0 to t1 (ns)."""
        pose = relative_pose(self._twists, t0, t1)
        if pose is None:
            return None
        width, height = self._camera.size
        grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        flow = displace(self._camera, grid.reshape(-1, 2), pose[0], pose[1] / self._depth)
        flow = flow.reshape(height, width, 2)
        valid = np.isfinite(flow).all(axis=-1)
        return TrueFlow(np.where(valid[..., None], flow, 0).astype(np.float32), valid)
