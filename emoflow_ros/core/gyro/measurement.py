"""The angular velocity that a gyro's readings measure over an interval."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera_motion import GREVILLE
from emoflow_ros.core.gyro.settings import GYRO
from emoflow_ros.core.types.gyro import GyroReadings

Array = NDArray[np.float64]


class GyroMeans:
    """Means of a gyro's readings over intervals, fast for many intervals.

    Args:
        t: (N,) int64 ns, increasing.
        w: (N, 3).
    """

    def __init__(self, t: NDArray[np.int64], w: Array) -> None:
        self._t = t
        seconds = np.diff(t)[:, None] / 1e9
        steps = 0.5 * (w[1:] + w[:-1]) * seconds
        self._integral = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def over(self, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> Array:
        """Mean (M, 3) over each interval; NaN where readings do not cover it."""
        origin = int(self._t[0])
        own = (self._t - origin).astype(np.float64)
        means = np.full((len(starts), 3), np.nan)
        inside = (starts >= self._t[0]) & (ends <= self._t[-1])
        a = (starts[inside] - origin).astype(np.float64)
        b = (ends[inside] - origin).astype(np.float64)
        for axis in range(3):
            area = np.interp(b, own, self._integral[:, axis])
            area -= np.interp(a, own, self._integral[:, axis])
            means[inside, axis] = area / ((b - a) / 1e9)
        return means


@dataclass(frozen=True)
class GyroMeasurement:
    """The angular velocity of an interval, without the bias as far as that is known.

    Over s = 0 at the interval's start to 1 at its end, w(s) = c[0] + c[1] (2s - 1) +
    c[2] (6s^2 - 6s + 1).

    Attributes:
        t_start, t_end: the interval, ns.
        coefficients: c, (3, 3) rad/s; a row for each polynomial, a column for each axis.
        covariances: (3, 3, 3) of each row; that of the bias is in the first one.
    """

    t_start: int
    t_end: int
    coefficients: Array
    covariances: Array

    @property
    def w(self) -> Array:
        """Mean angular velocity (3,), rad/s."""
        return self.coefficients[0]

    @property
    def covariance(self) -> Array:
        """Covariance (3, 3) of the mean: noise, bias, scale, mounting, clock and gaps."""
        return self.covariances[0]

    @property
    def middle(self) -> Array:
        """Angular velocity (3,) in the middle of the interval, rad/s."""
        return self.coefficients[0] - 0.5 * self.coefficients[2]

    @property
    def middle_covariance(self) -> Array:
        """Covariance (3, 3) of the angular velocity in the middle."""
        covariance: Array = self.covariances[0] + 0.25 * self.covariances[2]
        return covariance

    def control_points(self) -> Array:
        """Control points (4, 3), rad/s, of the cubic spline (camera_motion.basis) that is w(s)."""
        a = GREVILLE[:, None]  # p(a) - p''(a) / 6 for a polynomial p
        return np.hstack([np.ones_like(a), 2 * a - 1, 6 * a * (a - 1) - 1]) @ self.coefficients

    def at(self, s: float) -> Array:
        """Angular velocity (3,) at s in [0, 1] of the interval, rad/s."""
        w: Array = np.array([1.0, 2 * s - 1, 6 * s * (s - 1) + 1]) @ self.coefficients
        return w


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
    between = ((GYRO.curvature * gaps**3 / 12) ** 2).sum()
    beyond = ((GYRO.acceleration * np.maximum(held, 0.0) ** 2 / 2) ** 2).sum()
    return float((between + beyond) / ((t_end - t_start) / 1e9) ** 2)
