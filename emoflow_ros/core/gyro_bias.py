"""The bias of a gyro, learnt from the angular velocity that the events tell."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro_config import GyroConfig

Array = NDArray[np.float64]

# Errors of the events' estimates that are nearer than this in time go together, s.
_CORRELATED_S = 0.25
_MOST_DOUBT = 8.0
_OUTLIER = 16.3  # squared distance in standard deviations that 0.1 % exceed


class BiasFilter:
    """A Kalman filter of the bias (3,), a random walk.

    The events' estimates come from windows that overlap, and each starts from the one before it, so
    that their errors repeat. An update after dt seconds therefore counts dt / tau of one, with tau
    the window's length and at least 0.25 s: together they tell as much as estimates that are tau
    apart.

    Attributes:
        mean: (3,) rad/s.
        covariance: (3, 3).
    """

    def __init__(self, config: GyroConfig) -> None:
        self._start = np.radians(config.bias_deg_s) ** 2 * np.eye(3)
        self._walk = float(np.radians(config.bias_walk) ** 2)
        self.mean = np.zeros(3)
        self.covariance = self._start.copy()
        self._since_update = np.inf

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.covariance = self.covariance + self._walk * seconds * np.eye(3)
        self._since_update += seconds

    def doubt(self) -> None:
        """Trust what is known half as much, down to eight times the bias that is expected."""
        most = _MOST_DOUBT**2 * np.trace(self._start)
        if np.trace(self.covariance) < most:
            self.covariance = 4 * self.covariance + self._start

    def update(self, difference: Array, covariance: Array, duration: float) -> bool:
        """Take the gyro's reading less the events' estimate; False if it is an outlier.

        Args:
            difference: (3,) rad/s.
            covariance: (3, 3) of all in it but the bias.
            duration: of the window, s.
        """
        apart = difference - self.mean
        if apart @ np.linalg.solve(self.covariance + covariance, apart) > _OUTLIER:
            return False
        repeated = max(1.0, max(_CORRELATED_S, duration) / max(self._since_update, 1e-3))
        noise = repeated * covariance
        gain = np.linalg.solve(self.covariance + noise, self.covariance).T
        kept = np.eye(3) - gain
        self.mean = self.mean + gain @ apart
        self.covariance = kept @ self.covariance @ kept.T + gain @ noise @ gain.T
        self._since_update = 0.0
        return True
