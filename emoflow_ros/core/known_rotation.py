"""What a gyro says about a window's rotation, as the fit's normal equations take it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.belief import INFORMATION_EXCESS
from emoflow_ros.core.gyro import GyroMeasurement
from emoflow_ros.core.spline import CONTROL_POINTS

Array = NDArray[np.float64]

_MEAN = np.array([1.0, 11.0, 11.0, 1.0]) / 24  # of the spline over the window, by control points
_GREVILLE = np.arange(CONTROL_POINTS) - 1.0  # control points there make a spline a straight line


@dataclass(frozen=True)
class KnownRotation:
    """The angular velocity of a window, in rad per window, and how well it is known.

    Only its mean takes part in the fit: tied to the slope, too, the fit converges worse.

    Attributes:
        mean: (3,).
        information: (3, 3) of the mean, in units of the normal equations, which are too sure by
            INFORMATION_EXCESS.
        slope: (3,) half of its change over the window.
        bend: (3,) what it is in the middle of the window, less the mean.
    """

    mean: Array
    information: Array
    slope: Array
    bend: Array

    @classmethod
    def measured(cls, measurement: GyroMeasurement, duration: float) -> Self:
        """Take it from a gyro's measurement of a window of `duration` seconds."""
        information = INFORMATION_EXCESS * np.linalg.inv(measurement.covariance) / duration**2
        mean, slope = duration * measurement.coefficients[:2]
        return cls(mean, information, slope, duration * measurement.middle - mean)

    def control_points(self) -> Array:
        """Build the control points (4, 3) of mean and slope."""
        return self.mean + np.outer(2 * _GREVILLE - 1, self.slope)

    def add_to(self, w: Array, corner: Array, corner_vector: Array) -> None:
        """Add it to normal equations.

        Args:
            w: (4, 3) present control points, rad per window.
            corner: (M, M), the control points' 12 unknowns first.
            corner_vector: (M,).
        """
        unknowns = 3 * CONTROL_POINTS
        corner[:unknowns, :unknowns] += np.kron(np.outer(_MEAN, _MEAN), self.information)
        surprise = self.information @ (self.mean - _MEAN @ w)
        corner_vector[:unknowns] += np.kron(_MEAN, surprise)
