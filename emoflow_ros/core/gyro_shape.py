"""The angular velocity over an interval, from readings at single times."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro_readings import GyroReadings

Array = NDArray[np.float64]

# How a camera may turn where there is no reading: beyond the last one, and between two.
_ACCELERATION = 20.0  # rad/s^2
_CURVATURE = 1000.0  # rad/s^3, the angular velocity's second derivative


@dataclass(frozen=True)
class Shape:
    """A polynomial of second degree: constant, linear and quadratic part of w over an interval.

    Attributes:
        coefficients: (3, 3) rad/s, of the Legendre polynomials of degree 0, 1 and 2 (rows) over
            the interval, for each axis (columns); the first row is the mean.
        gap_variance: of the mean, (rad/s)^2, by what happens between two readings.
    """

    coefficients: Array
    gap_variance: float


def fit_shape(readings: GyroReadings, t_start: int, t_end: int) -> Shape:
    """Fit readings that are joined by straight lines and held where they begin or end inside.

    Args:
        readings: one at least, finite, in the order of time.
        t_start, t_end: the interval, ns.
    """
    inside = readings.t[(readings.t > t_start) & (readings.t < t_end)]
    knots = np.concatenate([[t_start], inside, [t_end]]).astype(np.int64)
    since = (knots - t_start).astype(np.float64)
    own = (readings.t - t_start).astype(np.float64)
    w = np.stack([np.interp(since, own, readings.w[:, axis]) for axis in range(3)], axis=1)
    x = 2 * since / since[-1] - 1
    coefficients = np.empty((3, 3))
    for degree in range(3):
        coefficients[degree] = (degree + 0.5) * _integral(x, w, degree)
    return Shape(coefficients, _gap_variance(readings, t_start, t_end))


def _integral(x: Array, w: Array, degree: int) -> Array:
    """Integrate w, linear between the knots x (N,), times a Legendre polynomial over x."""
    middle = 0.5 * (x[1:] + x[:-1])
    # Simpson's rule is exact for the third degree.
    weighted = _legendre(x, degree)[:, None] * w
    between = _legendre(middle, degree)[:, None] * 0.5 * (w[1:] + w[:-1])
    steps = np.diff(x)[:, None] / 6
    total: Array = (steps * (weighted[:-1] + 4 * between + weighted[1:])).sum(axis=0)
    return total


def _legendre(x: Array, degree: int) -> Array:
    return (np.ones_like(x), x, 1.5 * x**2 - 0.5)[degree]


def _gap_variance(readings: GyroReadings, t_start: int, t_end: int) -> float:
    gaps = np.diff(readings.t) / 1e9
    held = np.array([int(readings.t[0]) - t_start, t_end - int(readings.t[-1])]) / 1e9
    between = ((_CURVATURE * gaps**3 / 12) ** 2).sum()
    beyond = ((_ACCELERATION * np.maximum(held, 0.0) ** 2 / 2) ** 2).sum()
    return float((between + beyond) / ((t_end - t_start) / 1e9) ** 2)
