"""An estimator whose answers are known, and the errors of one pixel."""

import math

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_S

START = 100 * NS_PER_S
ANGULAR, LINEAR = np.array([0.05, -0.2, 0.3]), np.array([0.25, 0.1, -0.15])


def velocity(t: float, x, y):
    """What the estimator says: flow in px/s at a pixel, t in s from START."""
    return 30 + 0.05 * x - 0.02 * y, -40 + 0.1 * y + 25 * t


class KnownFlow:
    """The flow of the middle of an interval, held over it."""

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def displacement(self, t0: int, t1: int) -> np.ndarray:
        camera = self._camera
        grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1)
        points = grid.reshape(-1, 2).astype(float)
        return (self.tracks(points, (t0, t1))[1] - points).reshape(grid.shape)

    def tracks(self, points: np.ndarray, times) -> np.ndarray:
        (t0, t1), (x, y) = times, points.T
        u, v = velocity((0.5 * (t0 + t1) - START) / NS_PER_S, x, y)
        return np.stack([points, points + np.stack([u, v], -1) * (t1 - t0) / NS_PER_S])


class KnownMotion:
    def angular(self, t: int) -> np.ndarray:
        """The true rate and an error that grows with time, by axis."""
        return ANGULAR + np.array([0.1, -0.05, 0.2]) * (t - START) / NS_PER_S

    def linear(self, t: int) -> np.ndarray:
        return LINEAR / np.linalg.norm(LINEAR)


class Known:
    """An estimator that always says the same, whatever the events are."""

    def __init__(self, camera: Camera, config=None) -> None:
        self._camera = camera

    def estimate(self, window) -> Estimate:
        t = (window.t_start + window.t_end) // 2
        motion = KnownMotion()
        return Estimate(
            window.t_start,
            window.t_end,
            t,
            Status.OK,
            Quality(events=len(window.events)),
            MotionModel.FULL,
            linear=motion.linear(t),
            angular=motion.angular(t),
            flow=KnownFlow(self._camera),
            motion=motion,
        )

    def reset(self) -> None:
        pass


def errors_of(ours, true):
    """EPE and space-time angle of one pixel."""
    (u, v), (tu, tv) = ours, true
    dot = (u * tu + v * tv + 1) / math.sqrt((u * u + v * v + 1) * (tu * tu + tv * tv + 1))
    return math.hypot(u - tu, v - tv), math.degrees(math.acos(min(1.0, dot)))
