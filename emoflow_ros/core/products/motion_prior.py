"""A motion that goes on: a random walk of w and of the direction of translation."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.types.estimate import Motion
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Known:
    """What is known of the motion at one time.

    Attributes:
        t: event time, ns.
        linear: (3,) unit direction of translation; zeros where it is not known, and at rest.
        angular: (3,) rad/s.
        covariance: (6, 6) of (linear, angular), as that of an Estimate.
    """

    t: int
    linear: Array
    angular: Array
    covariance: Array

    @property
    def translates(self) -> bool:
        """Whether a direction of translation is known."""
        return bool(self.linear.any())

    def narrow(self) -> "Known":
        """Return it without a direction that is wider than 60 degrees."""
        if not self.translates:
            return self
        widest = np.radians(BackEndSettings.widest_direction_deg)
        if np.linalg.eigvalsh(self.covariance[:3, :3])[-1] <= widest**2:
            return self
        return replace(self, linear=np.zeros(3), covariance=without_translation(self.covariance))

    def held_against(self, covariance: Array) -> "Known":
        """Return it together with the evidence that w is zero, with a covariance (3, 3).

        The direction stays, and so does its covariance.
        """
        share = self.share_against(covariance)
        both, of_w = self.covariance.copy(), share @ self.covariance[3:, 3:]
        both[:3, 3:] = both[:3, 3:] @ share.T
        both[3:, :3] = both[:3, 3:].T
        both[3:, 3:] = 0.5 * (of_w + of_w.T)
        return replace(self, angular=share @ self.angular, covariance=both)

    def share_against(self, covariance: Array) -> Array:
        """Return what that evidence leaves of w, (3, 3)."""
        share: Array = covariance @ np.linalg.inv(self.covariance[3:, 3:] + covariance)
        return share


@dataclass(frozen=True)
class HeldMotion:
    """A window's motion of whose angular velocity a share is left (a Motion).

    Attributes:
        motion: as it was measured.
        share: (3, 3).
    """

    motion: Motion
    share: Array

    def angular(self, t: int) -> Array:
        """Angular velocity at time t (ns), (3,) rad/s."""
        return self.share @ self.motion.angular(t)

    def linear(self, t: int) -> Array:
        """Direction of the linear velocity at time t (ns), (3,)."""
        return self.motion.linear(t)


def carried(motion: Known, t: int, angular: float, direction: float) -> Known:
    """Let a motion go on until time t, ns; one at rest goes on without a direction.

    Args:
        motion: at its time.
        t: no earlier.
        angular: variance of each component of w that is added per second, (rad/s)^2.
        direction: the same for the direction of translation, across it, rad^2.
    """
    seconds = max(0, t - motion.t) / NS_PER_S
    covariance = motion.covariance.copy()
    covariance[3:, 3:] += angular * seconds * np.eye(3)
    if not motion.translates:
        return Known(t, np.zeros(3), motion.angular, without_translation(covariance))
    across = np.eye(3) - np.outer(motion.linear, motion.linear)
    covariance[:3, :3] += direction * seconds * across
    return Known(t, motion.linear, motion.angular, covariance).narrow()
