"""Events of dots that move across a sensor, without end."""

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events

_DOTS = 400
_RIGHT, _DOWN = 100.0, 30.0  # px/s


class MovingDots:
    """A dot gives an event in each column that it enters; beyond an edge it comes in opposite."""

    def __init__(self) -> None:
        rng = np.random.default_rng(0)
        self._x, self._y = rng.uniform(0, 10_000, (2, _DOTS))
        self._p = rng.random(_DOTS) < 0.5

    def events(self, camera: Camera, start: int, t: int, length: int) -> Events:
        """Return the events of an interval, and one at its beginning.

        Args:
            camera: whose events they are.
            start: when the dots began to move, ns.
            t, length: the interval, ns; less than a dot takes from one column to the next.
        """
        since = (t - start) / NS_PER_S
        before = np.floor(self._x + _RIGHT * since)
        after = np.floor(self._x + _RIGHT * (since + length / NS_PER_S))
        [entered] = np.nonzero(after > before)
        when = (after[entered] - self._x[entered]) / _RIGHT
        times = start + np.round(when * NS_PER_S).astype(np.int64)
        entered = entered[order := np.argsort(times, kind="stable")]
        x, y = after[entered], self._y[entered] + _DOWN * when[order]
        times = np.clip(times[order], t, t + length - 1)
        return Events(
            np.concatenate([[0], x % camera.width]).astype(np.uint16),
            np.concatenate([[0], y % camera.height]).astype(np.uint16),
            np.concatenate([[t], times]),
            np.concatenate([[False], self._p[entered]]),
        )
