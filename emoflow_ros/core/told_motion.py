"""The motion that is told of a window, and its covariance: one decision from all that is known."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.consistency import (
    Experience,
    angular_factor,
    direction_variance,
    factor_by_gyro,
    variance_by_gyro,
)
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.odometry import State
from emoflow_ros.core.types.estimate import Estimate, MotionModel
from emoflow_ros.core.types.events import NS_PER_S, Window
from emoflow_ros.core.types.gyro import GyroState, SeenBias

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ToldMotion:
    """What is told of a window's motion.

    Attributes:
        model: rotation where the direction of translation is not told.
        linear: (3,) that direction; zero where it is not told.
        angular: (3,) rad/s.
        covariance: (6, 6) of (linear, angular), as of an estimate.
        variance: of the direction about either axis across it, rad^2, whether it is told or not.
    """

    model: MotionModel
    linear: Array
    angular: Array
    covariance: Array
    variance: float

    @classmethod
    def of(
        cls, window: Window, found: Estimate, state: State, experience: Experience, kept: float,
        settings: BackEndSettings,
    ) -> "ToldMotion":  # fmt: skip
        """Tell a motion by positions; a gyro's angular velocity stays.

        Args:
            window: whose motion is told.
            found: what the lattice estimates of it.
            state: of the memory, adjusted.
            experience: with this motion.
            kept: share of the patches followed so far that the newest slice shows.
            settings: of the back end.
        """
        motion = state.motion(found.t)
        assert motion is not None and state.adjusted is not None
        law, by_gyro = settings.errors, found.gyro.state is GyroState.USED
        spread, spread_of_direction = state.spread(found.t)
        covariance = np.zeros((6, 6))
        if by_gyro:
            angular, covariance[3:, 3:] = found.angular, found.covariance[3:, 3:]
        else:
            factor = angular_factor(experience, kept, _seconds(window, found), law)
            if found.flow is not None:  # else the lattice measures nothing
                # Of two that are as good, each has half the variance of their difference.
                spread = spread + 0.5 * np.outer(experience.away, experience.away)
            angular, covariance[3:, 3:] = motion.angular, factor * motion.covariance + spread
        speed = float(np.linalg.norm(motion.linear))
        variance = direction_variance(experience, kept, state.adjusted.mean_cost(settings), law)
        if by_gyro:
            variance += variance_by_gyro(covariance[3:, 3:], speed, law)
        if state.adjusted.translates and speed > 0:
            direction = motion.linear / speed
            covariance[:3, :3] = across(direction, variance) + spread_of_direction
            widest = np.radians(settings.widest_direction_deg)
            if np.linalg.eigvalsh(covariance[:3, :3])[-1] < widest**2:
                return cls(MotionModel.FULL, direction, angular, covariance, variance)
        unknown = without_translation(covariance)
        return cls(MotionModel.ROTATION, np.zeros(3), angular, unknown, variance)


def told_bias(state: State, t: int, settings: BackEndSettings) -> SeenBias:
    """Tell a gyro's bias by positions.

    Its covariance grows with the misfit, and by how far w differs between ways and between parts of
    the image.

    Args:
        state: of the memory, with a bias.
        t: time that the ways are compared at, ns.
        settings: of the back end.
    """
    assert state.bias is not None and state.adjusted is not None
    law = settings.errors
    factor = law.bias * max(state.adjusted.mean_cost(settings), law.least_cost)
    covariance = factor * state.bias.covariance + state.spread(t)[0]
    return replace(state.bias, covariance=covariance)


def as_experienced(told: Array, experience: Experience, settings: BackEndSettings) -> Array:
    """The covariance (6, 6) of a motion whose w a gyro told, as wide as its bias was wrong.

    That is told alone: the flow and the direction are no better for it.

    Args:
        told: covariance of the motion.
        experience: with this motion.
        settings: of the back end.
    """
    covariance = told.copy()
    covariance[3:, 3:] *= factor_by_gyro(experience, settings.errors)
    return covariance


def _seconds(window: Window, found: Estimate) -> float:
    """Length of the part that the motion is of; all where what is short was tried, not measured."""
    if not found.quality.warm:
        return window.duration
    return (found.t_end - found.t_start) / NS_PER_S


def across(direction: Array, variance: float) -> Array:
    """Covariance (3, 3) of a unit vector with a variance about either axis across it."""
    return variance * (np.eye(3) - np.outer(direction, direction))
