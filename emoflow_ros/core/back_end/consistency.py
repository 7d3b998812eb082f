"""How far an adjusted motion is to be believed, by what it has been found to be worth.

Errors of tracks are outliers rather than noise, and a search may end in a wrong minimum: neither
shows in the normal equations. What does show is a motion that the next adjustment revises, patches
that are lost, slow events, whose windows are long, places that do not fit, and another motion that
the lattice measures. Which of these the variance of the error goes with, and by which powers, was
found on the errors of recordings (docs/experiments.md).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.settings import ErrorLaw
from emoflow_ros.core.back_end.trajectory import MotionAt
from emoflow_ros.core.types.gyro import KnownBias, SeenBias

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Experience:
    """Running means of what shows errors that the normal equations do not.

    Attributes:
        revised: log of the squared change of the angular velocity, as the next adjustment revises
            it, over its covariance, per axis.
        turned: log of the angle (rad) by which it revises the direction of translation.
        astray: angle (rad) to the direction that the lattice measures; None before the first
            window.
        away: (3,) rad/s, the lattice's angular velocity less the adjusted one of the last window.
        biased: log of the squared excess over a gyro's bias that places show, over the covariance
            of both, per axis, less that of the usual one.
        t: the time that the last motion was told for, ns; None before one.
        motion: that was told.
    """

    revised: float
    turned: float
    astray: float | None = None
    away: Array = field(default_factory=lambda: np.zeros(3))
    biased: float = 0.0
    t: int | None = None
    motion: MotionAt | None = None

    @classmethod
    def none(cls, law: ErrorLaw) -> "Experience":
        """What is assumed before anything is known."""
        return cls(float(np.log(law.usual_revision)), float(np.log(law.usual_turn)))

    def after(
        self, t: int, motion: MotionAt, again: MotionAt | None, measured: tuple[Array, Array],
        law: ErrorLaw, bias: tuple[SeenBias, KnownBias] | None = None,
    ) -> "Experience":  # fmt: skip
        """Learn from another adjustment.

        Args:
            t: the time that it tells a motion for, ns.
            motion: that motion.
            again: what it tells for the time before; None where it does not reach back.
            measured: angular velocity (3,) rad/s and direction (3,) as the lattice measures them
                at t; the direction is zero where unknown.
            law: what is made of it.
            bias: of the gyro, as places show it and as it was known; None without.
        """
        away = measured[0] - motion.angular
        astray = _angle(measured[1], motion.linear, law.unknown_angle)
        revised, turned = self.revised, self.turned
        if self.motion is not None and again is not None:
            change = again.angular - self.motion.angular
            squared = float(change @ np.linalg.solve(self.motion.covariance, change)) / 3
            angle = _angle(again.linear, self.motion.linear, law.unknown_angle)
            revised = _mixed(revised, float(np.log(law.least + squared)), law)
            turned = _mixed(turned, float(np.log(law.least + angle)), law)
        biased = self.biased
        if bias is not None:
            seen, known = bias
            both = seen.covariance + known.covariance
            excess = float(seen.excess @ np.linalg.solve(both, seen.excess)) / 3
            biased = _mixed(biased, float(np.log((law.least + excess) / law.usual_excess)), law)
        return Experience(
            revised, turned, _mixed(self.astray, astray, law), away, biased, t, motion
        )


def angular_factor(experience: Experience, kept: float, seconds: float, law: ErrorLaw) -> float:
    """By how much the squared error of an angular velocity usually exceeds its covariance.

    Args:
        experience: with this motion.
        kept: share of the patches followed so far that the newest slice shows.
        seconds: that the window lasts, s; all of it where the lattice's fit is cold or none.
        law: what is made of it.
    """
    revised = float(np.exp(experience.revised))
    return law.angular * seconds * (revised / max(kept, law.least)) ** 2


def factor_by_gyro(experience: Experience, law: ErrorLaw) -> float:
    """By how much the squared error of a gyro's w usually exceeds its covariance."""
    return max(law.least_factor, float(np.exp(experience.biased)))


def direction_variance(experience: Experience, kept: float, cost: float, law: ErrorLaw) -> float:
    """Variance of the direction of translation about either axis across it, rad^2.

    That of the normal equations tells hardly anything of its error.

    Args:
        experience, kept, law: as of `angular_factor`.
        cost: of an observation on average, over what it is where the covariance is right.
    """
    assert experience.astray is not None
    off = float(np.exp(experience.turned + experience.astray)) * max(cost, law.least_cost)
    return law.direction * off**2 / max(kept, law.least)


def variance_by_gyro(angular: Array, speed: float, law: ErrorLaw) -> float:
    """Variance of the direction about either axis by the error of a gyro's w, rad^2.

    What a wrong w leaves of the flow looks like travel. What the adjustment shows does not tell of
    it, for the lattice's direction is as wrong.

    Args:
        angular: (3, 3) covariance of w, (rad/s)^2.
        speed: of the camera, mean depths per second.
        law: what is made of it.
    """
    return law.of_gyro * float(np.trace(angular)) / 3 / max(speed, law.least) ** 2


def _angle(a: Array, b: Array, unknown: float) -> float:
    """Angle between two vectors (3,), rad; `unknown` where one is zero."""
    if not (a.any() and b.any()):
        return unknown
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _mixed(before: float | None, now: float, law: ErrorLaw) -> float:
    """A running mean, which begins with the first value."""
    return now if before is None else (1 - law.share) * before + law.share * now
