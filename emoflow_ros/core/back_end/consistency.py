"""How far an adjusted motion is to be believed, by what it has been found to be worth.

Errors of tracks are outliers rather than noise, and a search may end in a wrong minimum: neither
shows in the normal equations. What does show is a motion that the next adjustment revises, another
one that the lattice measures, places that do not fit, patches that were seen but a few times, and
slow events, whose windows are long. How the variance of the error goes with these was fitted to the
errors of recordings (docs/experiments.md): to powers of most, exponentially to the angle. How far
the lattice's motion is away in the window itself is a part of its own.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.settings import ErrorLaw
from emoflow_ros.core.back_end.trajectory import MotionAt

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Experience:
    """Running means of what shows errors that the normal equations do not.

    Attributes:
        revised: log of the squared change of the angular velocity, as the next adjustment revises
            it, over its covariance, per axis.
        turned: log of the angle (rad) by which it revises the direction of translation.
        apart: log of the distance (rad/s) to the angular velocity that the lattice measures; None
            before the first window.
        astray: angle (rad) to the direction that the lattice measures; None as well.
        away: (3,) rad/s, the lattice's angular velocity less the adjusted one of the last window.
        t: the time that the last motion was told for, ns; None before one.
        motion: that was told.
    """

    revised: float
    turned: float
    apart: float | None = None
    astray: float | None = None
    away: Array = field(default_factory=lambda: np.zeros(3))
    t: int | None = None
    motion: MotionAt | None = None

    @classmethod
    def none(cls, law: ErrorLaw) -> "Experience":
        """What is assumed before anything is known."""
        return cls(float(np.log(law.usual_revision)), float(np.log(law.usual_turn)))

    def after(
        self, t: int, motion: MotionAt, again: MotionAt | None, measured: tuple[Array, Array],
        law: ErrorLaw,
    ) -> "Experience":  # fmt: skip
        """Learn from another adjustment.

        Args:
            t: the time that it tells a motion for, ns.
            motion: that motion.
            again: what it tells for the time before; None where it does not reach back.
            measured: angular velocity (3,) rad/s and direction (3,) as the lattice measures them
                at t; the direction is zero where unknown.
            law: what is made of it.
        """
        away = measured[0] - motion.angular
        apart = float(np.log(law.least_apart + np.linalg.norm(away)))
        astray = _angle(measured[1], motion.linear, law.unknown_angle)
        revised, turned = self.revised, self.turned
        if self.motion is not None and again is not None:
            change = again.angular - self.motion.angular
            squared = float(change @ np.linalg.solve(self.motion.covariance, change)) / 3
            angle = _angle(again.linear, self.motion.linear, law.unknown_angle)
            revised = _mixed(revised, float(np.log(law.least_revision + squared)), law)
            turned = _mixed(turned, float(np.log(law.least_turn + angle)), law)
        return Experience(
            revised,
            turned,
            _mixed(self.apart, apart, law),
            _mixed(self.astray, astray, law),
            away,
            t,
            motion,
        )


def angular_factor(
    experience: Experience, cost: float, times_seen: float, seconds: float, law: ErrorLaw
) -> float:
    """By how much the squared error of an angular velocity usually exceeds its covariance.

    Args:
        experience: with this motion.
        cost: of an observation on average, over what it is where the covariance is right.
        times_seen: number of slices on average that show a patch.
        seconds: that the window lasts, s; all of it where the lattice's fit is cold or none.
        law: what is made of it.
    """
    assert experience.apart is not None
    return law.angular * float(
        np.exp(experience.apart + law.of_revised * experience.revised)
        * max(cost, law.least_cost) ** law.of_cost
        * seconds
        / (1 + times_seen) ** 2
    )


def direction_variance(experience: Experience, cost: float, law: ErrorLaw) -> float:
    """Variance of the direction of translation about either axis across it, rad^2.

    That of the normal equations tells hardly anything of its error. Arguments as `angular_factor`.
    """
    assert experience.astray is not None
    return law.direction * float(
        np.exp(law.of_astray * experience.astray + 2 * experience.turned)
        * max(cost, law.least_cost) ** law.of_cost_direction
    )


def _angle(a: Array, b: Array, unknown: float) -> float:
    """Angle between two vectors (3,), rad; `unknown` where one is zero."""
    if not (a.any() and b.any()):
        return unknown
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _mixed(before: float | None, now: float, law: ErrorLaw) -> float:
    """A running mean, which begins with the first value."""
    return now if before is None else (1 - law.share) * before + law.share * now
