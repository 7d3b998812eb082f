"""What is known of the motion and the scene before a window's own events are used.

Earlier windows leave the inverse depths of the scene; a gyro measures the rotation, and the memory
of positions the motion.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.egomotion import OF_W, NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.settings import LATTICE

Array = NDArray[np.float64]

INFORMATION_EXCESS = LATTICE.information_excess

# Weights of start and end in the mean over the window, and in half of the change
_MEAN, _SLOPE = np.array([0.5, 0.5]), np.array([-0.5, 0.5])


@dataclass(frozen=True)
class MotionPrior:
    """What is known of the mean motion over a window.

    Attributes:
        mean: (6,) w in rad per window, v.
        information: (6, 6).
    """

    mean: Array
    information: Array


@dataclass(frozen=True)
class Structure:
    """Structure of the scene, carried on as inverse depths at the nodes with their certainty.

    One window tells rotation and sideways translation apart only by the scene's relief, and
    poorly. The relief stays while the motion changes. Without it the translational flow u - b w
    has a free length along the epipolar line. With it this length is speed * rho * |a v|, known
    but for the speed, which no single camera knows.

    Attributes:
        inverse_depth: (nodes,) for a unit v, in travelled distances per window.
        information: (nodes,) inverse variances.
    """

    inverse_depth: Array
    information: Array

    @classmethod
    def observe(
        cls,
        epipolar: NodeEpipolar,
        flow: Array,
        motion: tuple[Array, Array],
        evidence: Array,
        predicted: "Structure | None",
    ) -> "Structure":
        """Read it from a fitted flow.

        Args:
            epipolar: the lattice's constraint.
            flow: (nodes, 2) px per window.
            motion: w (3,) rad per window and v (3,) unit.
            evidence: (nodes, 2, 2) the events' information on the flow.
            predicted: what the fit already knew, and may count on again.
        """
        w, v = motion
        line, squared = _lines(epipolar, v)
        translational = flow - epipolar.b @ w
        inverse_depth = (translational * line).sum(-1) / squared
        along = ((line[:, None] @ evidence)[:, 0] * line).sum(-1)
        information = epipolar.usable * along / INFORMATION_EXCESS
        if predicted is not None:
            information = information + predicted.information
        return cls(inverse_depth, information)

    def predict(
        self,
        lattice: Lattice,
        epipolar: NodeEpipolar,
        flow: Array,
        windows: float,
        v: Array,
        drift: float,
    ) -> "Structure":
        """Move it along with the scene into a later window.

        Args:
            lattice: the flow's.
            epipolar: the lattice's constraint.
            flow: (nodes, 2) px per window, now.
            windows: how far ahead, in windows.
            v: (3,) unit direction of translation.
            drift: relative change of depth that is expected anyway.
        """
        _, squared = _lines(epipolar, v)
        error = (drift * self.inverse_depth) ** 2 + LATTICE.flow_error_px**2 / squared
        certainty = 1 / (1 / np.maximum(self.information, 1e-9) + error)
        source = lattice.pixels - windows * flow
        certain = np.stack([certainty, certainty * self.inverse_depth], axis=-1)
        known, inverse_depth = lattice.interpolate(certain, source).T
        inside = ((source >= 0) & (source <= lattice.pixels[-1])).all(axis=-1)
        return Structure(inverse_depth / known, np.where(inside, known, 1e-9))


def _lines(epipolar: NodeEpipolar, v: Array) -> tuple[Array, Array]:
    """Epipolar lines a v (nodes, 2) and their squared norms, never zero."""
    line = epipolar.a @ v
    return line, (line**2).sum(-1) + epipolar.soft**2


@dataclass(frozen=True)
class KnownRotation:
    """The angular velocity of a window, in rad per window, and how well it is known.

    Mean and slope take part in the fit.

    Attributes:
        mean: (3,).
        information: (3, 3) of the mean, in units of the normal equations, which are too sure by
            INFORMATION_EXCESS.
        slope: (3,) half of its change over the window.
        slope_information: (3, 3) likewise.
        bend: (3,) what it is in the middle of the window, less the mean.
    """

    mean: Array
    information: Array
    slope: Array
    slope_information: Array
    bend: Array

    @classmethod
    def measured(cls, measurement: GyroMeasurement, duration: float) -> Self:
        """Take it from a gyro's measurement of a window of `duration` seconds."""
        of_mean, of_slope = measurement.covariances[:2]
        information, slope_information = (
            INFORMATION_EXCESS * np.linalg.inv(covariance) / duration**2
            for covariance in (of_mean, of_slope + LATTICE.slope_error**2 * np.eye(3))
        )
        mean, slope = duration * measurement.coefficients[:2]
        bend = duration * measurement.middle - mean
        return cls(mean, information, slope, slope_information, bend)

    @classmethod
    def seen(cls, w: Array, covariance: Array) -> Self:
        """Take it from another estimate of the window.

        Args:
            w: (N, 3) at evenly spaced times from its start to its end, rad per window; N is odd.
            covariance: (3, 3) of each.
        """
        s = np.linspace(-1.0, 1.0, len(w))
        weight = np.ones(len(w))
        weight[[0, -1]] = 0.5
        mean = weight @ w / weight.sum()
        slope = (weight * s) @ w / (weight @ s**2)
        information = INFORMATION_EXCESS * np.linalg.inv(covariance)
        bend = w[len(w) // 2] - mean
        return cls(mean, information, slope, information, bend)

    def ends(self) -> Array:
        """Angular velocity at the window's start and end, (2, 3)."""
        return np.stack([self.mean - self.slope, self.mean + self.slope])

    def add_to(self, w: Array, corner: Array, corner_vector: Array) -> None:
        """Add it to normal equations.

        Args:
            w: (2, 3) at start and end, at present.
            corner: (13, 13) of a motion's unknowns.
            corner_vector: (13,).
        """
        for weights, known, information in (
            (_MEAN, self.mean, self.information),
            (_SLOPE, self.slope, self.slope_information),
        ):
            corner[np.ix_(OF_W, OF_W)] += np.kron(np.outer(weights, weights), information)
            surprise = information @ (known - weights @ w)
            corner_vector[OF_W] += np.kron(weights, surprise)
