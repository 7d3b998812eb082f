"""How far the covariance of an adjustment is to be believed.

Errors of tracks are outliers rather than noise, and a search may end in a wrong minimum: neither
shows in the normal equations. What does show is a motion that the next adjustment revises, another
one that the lattice measures, places that do not fit, and few patches.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import MotionAt

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Revisions:
    """How much adjustments have revised what the ones before them told.

    Attributes:
        mean: squared change of the angular velocity over its covariance, per axis; running mean.
        t: the time that the last motion was told for, ns; None before one.
        motion: that was told.
    """

    mean: float
    t: int | None = None
    motion: MotionAt | None = None

    def after(self, again: MotionAt | None, settings: BackEndSettings) -> float:
        """Return the mean after another adjustment.

        Args:
            again: what it tells for the time `t`; None where it does not reach back.
            settings: of the back end.
        """
        if self.motion is None or again is None:
            return self.mean
        squared = _squared(again.angular - self.motion.angular, self.motion)
        share = settings.revision_share
        return (1 - share) * self.mean + share * min(squared, settings.most_revision)


def covariance_factor(
    motion: MotionAt, mean_cost: float, shown: int, measured: Array, revision: float,
    settings: BackEndSettings,
) -> float:  # fmt: skip
    """By how much squared errors exceed the covariance of an adjusted motion.

    Its form was fitted to the errors of random recordings (docs/experiments.md).

    Args:
        motion: as adjusted.
        mean_cost: of an observation, over what it is where the covariance is right.
        shown: number of patches that the newest slice shows.
        measured: (3,) angular velocity as the lattice measures it, rad/s.
        revision: mean of Revisions.
        settings: of the back end.
    """
    misfit = max(mean_cost, settings.least_cost)
    few = 1 / float(np.sqrt(max(shown, settings.fewest_shown)))
    apart = 1 + _squared(measured - motion.angular, motion)
    return settings.excess * misfit * few * apart * revision


def _squared(change: Array, motion: MotionAt) -> float:
    """Square of a change (3,) of the angular velocity over its covariance, per axis."""
    return float(change @ np.linalg.solve(motion.covariance[3:, 3:], change)) / 3
