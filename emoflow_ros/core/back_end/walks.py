"""How restless the camera is: the motion prior's strength, learnt while it moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted
from emoflow_ros.core.back_end.adjustment_kernels import NODE
from emoflow_ros.core.back_end.settings import BackEndSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Walks:
    """Power spectral densities of the random walks of the velocities.

    Attributes:
        angular: rad^2/s^3.
        velocity: mean depths squared per s^3.
    """

    angular: float
    velocity: float

    @classmethod
    def unknown(cls, settings: BackEndSettings) -> "Walks":
        """What is assumed before anything is known."""
        return cls(settings.angular_walk, settings.velocity_walk**2)

    def learnt(self, adjusted: Adjusted, seconds: Array, settings: BackEndSettings) -> "Walks":
        """Learn from the steps of the velocities between nodes, and their covariance.

        One step of expectation and maximisation (Shumway and Stoffer, 1982), its logarithm
        averaged over the adjustments so far.

        Args:
            adjusted: K nodes.
            seconds: (K - 1,) between them.
            settings: of the back end.
        """
        nodes = len(seconds) + 1
        every = np.zeros((NODE * nodes,) * 2)
        every[np.ix_(adjusted.free, adjusted.free)] = adjusted.covariance
        blocks = every.reshape(nodes, NODE, nodes, NODE)
        angular = _step(adjusted.x.angular, blocks[:, 6:9, :, 6:9], float(seconds.sum()))
        least = float(np.radians(settings.least_angular_walk_deg)) ** 2
        angular = max(_mixed(self.angular, angular, settings), least)
        if not adjusted.translates:
            return Walks(angular, self.velocity)
        velocity = _step(adjusted.x.velocity, blocks[:, 9:, :, 9:], float(seconds.sum()))
        velocity = _mixed(self.velocity, velocity, settings)
        return Walks(angular, max(velocity, settings.least_velocity_walk**2))


def _step(values: Array, covariance: Array, seconds: float) -> float:
    """Expected square of the steps of (K, 3) values per axis and second.

    Args:
        values: at the nodes.
        covariance: (K, 3, K, 3) of them.
        seconds: from the first to the last node.
    """
    own = np.einsum("kaka->k", covariance)
    with_next = np.einsum("kaka->k", covariance[:-1, :, 1:])
    spread = own[:-1].sum() + own[1:].sum() - 2 * with_next.sum()
    return float(((np.diff(values, axis=0) ** 2).sum() + spread) / (3 * seconds))


def _mixed(before: float, now: float, settings: BackEndSettings) -> float:
    share = settings.learning
    return float(np.exp((1 - share) * np.log(before) + share * np.log(max(now, 1e-12))))
