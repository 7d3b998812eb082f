"""Streams that leave an exact number of events per pixel they move, and an estimator for them."""

from dataclasses import dataclass

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events, Window, WindowPolicy

MS = 1_000_000
START = 1_500_000_000_000_000_000
CAMERA = Camera(120, 90, 100.0, 100.0, 60.0, 45.0)
PER_PX = 50  # events


class Path:
    """A camera whose image moves along a path that is linear between knots.

    Args:
        speeds: px/s in intervals of 100 ms.
        per_px: events that it leaves per pixel.
    """

    def __init__(self, speeds, per_px: int = PER_PX) -> None:
        self._t = START + 100 * MS * np.arange(len(speeds) + 1)
        self._px = np.concatenate([[0.0], np.cumsum(speeds) * 0.1])
        count = int(self._px[-1] * per_px) + 1
        t = np.interp(np.arange(count) / per_px, self._px, (self._t - START).astype(float))
        x = np.zeros(count, np.uint16)
        self.events = Events(x, x, START + np.round(t).astype(np.int64), np.ones(count, np.bool_))

    def between(self, t0: int, t1: int) -> float:
        """Displacement in px."""
        at = np.interp([t0 - START, t1 - START], self._t - START, self._px)
        return float(at[1] - at[0])


@dataclass
class ExactFlow:
    path: Path

    def tracks(self, points, times):
        moved = np.array([self.path.between(times[0], t) for t in times])
        return points + moved[:, None, None] * np.array([0.6, -0.8])


class ExactEstimator:
    """Knows the path; notes the windows that it is given. `fails` says which of them it cannot.

    With a gyro it has an estimate of those, too, without a flow.
    """

    def __init__(self, path: Path, fails=lambda k: False, gyro: bool = False) -> None:
        self._path, self._fails, self._gyro = path, fails, gyro
        self.windows: list[Window] = []
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def estimate(self, window: Window) -> Estimate:
        fails = self._fails(len(self.windows))
        status = Status.NO_MOTION if fails and not self._gyro else Status.OK
        self.windows.append(window)
        middle = (window.t_start + window.t_end) // 2
        flow = None if fails else ExactFlow(self._path)
        quality = Quality(len(window.events))
        return Estimate(window.t_start, window.t_end, middle, status, quality, flow=flow)


def policy(bound: float = 8.0, min_count: int = 100, duration_ms=200.0, stride_ms=25.0):
    return WindowPolicy(
        duration_ms, stride_ms, max_displacement_px=bound, min_count=min_count
    )  # fmt: skip
