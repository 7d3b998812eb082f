"""Speeds by time, from a source outside of the estimation."""

from collections import deque

import numpy as np

_KEPT = 1000  # speeds: seconds of any odometry


class SpeedLog:
    """The latest speeds, and what they were at the time of a window. Times are in ns."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=_KEPT)
        self._speeds: deque[float] = deque(maxlen=_KEPT)

    def add(self, t: int, speed: float) -> None:
        """Add a speed (m/s). One from before the last, as in a bag that loops, begins anew."""
        if self._times and t < self._times[-1]:
            self._times.clear()
            self._speeds.clear()
        self._times.append(t)
        self._speeds.append(speed)

    def at(self, t: int, max_age: int) -> float | None:
        """Interpolate linearly at time t; None if no speed is from within max_age of it."""
        since = np.array(self._times, np.int64) - t
        if not (np.abs(since) <= max_age).any():
            return None
        return float(np.interp(0.0, since, self._speeds))
