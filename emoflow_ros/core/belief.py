"""What is known about the egomotion from one window to the next."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_S

Array = NDArray[np.float64]

# One event edge is seen by many events and a lattice smooths their errors into each other:
# the normal equations are this much too sure (measured, docs/method.md).
INFORMATION_EXCESS = 10.0


@dataclass(frozen=True)
class Belief:
    """A Gaussian over (w, v): angular velocity in rad/s and unit direction of travel.

    Attributes:
        t: time that it holds at, ns.
        w, v: (3,) mean.
        covariance: (6, 6) of (w, v); along v itself it means nothing and is 1.
    """

    t: int
    w: Array
    v: Array
    covariance: Array

    @classmethod
    def from_information(cls, t: int, w: Array, v: Array, information: Array) -> "Belief":
        """Build it from the information of the normal equations on (w, v)."""
        covariance = INFORMATION_EXCESS * np.linalg.inv(information)
        across = np.eye(6)
        across[3:, 3:] -= np.outer(v, v)
        covariance = across @ covariance @ across.T
        covariance[3:, 3:] += np.outer(v, v)
        return cls(t, w, v, 0.5 * (covariance + covariance.T))

    def predicted_information(self, t: int, angular_drift: float, direction_drift: float) -> Array:
        """Information (6, 6) that is left on (w, v) at a later time, in the units given.

        Args:
            t: ns.
            angular_drift: rad/s per square root of a second.
            direction_drift: rad per square root of a second.
        """
        elapsed = max(0, t - self.t) / NS_PER_S
        drift = np.repeat([angular_drift**2, direction_drift**2], 3) * elapsed
        predicted: Array = INFORMATION_EXCESS * np.linalg.inv(self.covariance + np.diag(drift))
        return predicted

    def across(self) -> Array:
        """Covariance (6, 6) in the order of ROS twists, (v, w), with v across its direction."""
        order = np.r_[3:6, 0:3]
        covariance = self.covariance.copy()
        covariance[3:, 3:] -= np.outer(self.v, self.v)
        return covariance[np.ix_(order, order)]
