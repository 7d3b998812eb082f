"""What can be wrong with a gyro: faults of its readings, and mistakes in its axes or units."""

import math
from collections import deque
from itertools import pairwise, permutations, product

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.measurement import fit_shape
from emoflow_ros.core.gyro.settings import GYRO
from emoflow_ros.core.types.gyro import REACH_NS, GyroFault, GyroReadings

Array = NDArray[np.float64]

# Squared lengths, in standard deviations, that 0.1 % of draws from six and three axes exceed.
UNLIKELY_6, UNLIKELY_3 = 22.5, 16.3

_DEG = math.degrees(1.0)

# All 48 matrices of permuted and mirrored axes.
AXES: list[Array] = [
    np.diag(signs) @ np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


def find_fault(readings: GyroReadings, t_start: int, t_end: int, limit: float) -> GyroFault | None:
    """Look at the readings of an interval by themselves.

    Args:
        readings: those that cover the interval.
        t_start, t_end: ns.
        limit: the gyro's range in rad/s; 0 if it is not known.
    """
    if not len(readings):
        return GyroFault.SILENT
    if t_end - int(readings.t[-1]) > REACH_NS:
        return GyroFault.LATE
    steps = np.diff(readings.t, prepend=min(t_start, int(readings.t[0])))
    if steps.max() > REACH_NS or (steps[1:] <= 0).any():
        return GyroFault.GAP
    if not np.isfinite(readings.w).all():
        return GyroFault.NOT_FINITE
    if limit > 0 and np.abs(readings.w).max() >= GYRO.at_range * limit:
        return GyroFault.SATURATED
    return None


class FreezeWatch:
    """Notices a gyro that repeats one reading: ten times and for 50 ms or more.

    A gyro's noise changes every reading, also of a camera at rest.

    Attributes:
        until: time of the last reading (ns) that is known to be frozen; None if none was.
    """

    def __init__(self) -> None:
        self.until: int | None = None
        self._seen: int | None = None
        self._value: NDArray[np.float64] = np.full(3, np.nan)
        self._since = 0
        self._count = 0

    def take(self, readings: GyroReadings) -> None:
        """Look at the readings that have not been looked at before."""
        new = slice(0, None)
        if self._seen is not None:
            new = slice(int(np.searchsorted(readings.t, self._seen, "right")), None)
        t, w = readings.t[new], readings.w[new]
        if not len(t):
            return
        changes = (np.concatenate([self._value[None], w[:-1]]) != w).any(axis=1)
        first = np.flatnonzero(changes)
        # Runs of equal readings; the first may continue the one that is under way.
        bounds = [0, *first[first > 0].tolist(), len(t)]
        for k, (begin, end) in enumerate(pairwise(bounds)):
            if k > 0 or changes[0]:
                self._since, self._count = int(t[begin]), 0
            self._count += end - begin
            last = int(t[end - 1])
            if self._count >= GYRO.frozen_readings and last - self._since >= GYRO.frozen_ns:
                self.until = last
        self._value, self._seen = w[-1], int(t[-1])


class SteadyWatch:
    """Notices a gyro that has measured nothing but a constant and its noise for half a second.

    This is the gyro of a camera at rest, or of one that translates or rotates evenly.
    """

    def __init__(self) -> None:
        self._since = 0
        self._until: int | None = None
        self._first: Array = np.zeros(3)

    def take(self, readings: GyroReadings, t_end: int, density: float) -> Array | None:
        """Look at the readings up to a time.

        Args:
            readings: those of a window that ends then or later.
            t_end: the time, ns.
            density: the gyro's noise density, rad/s per square root of Hz.

        Returns:
            Their mean w (3,), rad/s, where they have been steady up to then; else None.
        """
        t_start = max(int(readings.t[0]), t_end - GYRO.look_ns) if len(readings) else t_end
        if t_end <= t_start:
            return None
        mean, slope, curve = fit_shape(readings, t_start, t_end).coefficients
        noise = min(density, GYRO.quiet) ** 2 * 1e9 / (t_end - t_start)  # variance of the mean
        uneven = float(slope @ slope / 3 + curve @ curve / 5) / noise
        off = float((mean - self._first) @ (mean - self._first)) / (2 * noise)
        if not uneven <= UNLIKELY_6:  # also if it is not a number
            self._until = None
            return None
        if self._until is None or not t_start <= self._until <= t_end or off > UNLIKELY_3:
            self._since, self._first = t_start, mean
        self._until = t_end
        return mean if t_end - self._since >= GYRO.steady_ns else None


def axis_names(matrix: Array) -> str:
    """Name the gyro's axes that the camera's x, y and z are, for example `+x, -z, +y`."""
    names = []
    for row in matrix:
        k = int(np.abs(row).argmax())
        names.append(f"{'+' if row[k] > 0 else '-'}{'xyz'[k]}")
    return ", ".join(names)


class MistakeGuess:
    """Guesses why a gyro and the events disagree, from the latest windows of both."""

    def __init__(self) -> None:
        self._pairs: deque[tuple[Array, Array]] = deque(maxlen=GYRO.compared)

    def add(self, gyro: Array, events: Array) -> None:
        """Take a window's angular velocities (3,), rad/s, of both; the gyro's with its bias."""
        self._pairs.append((gyro, events))

    def in_words(self) -> str:
        """Name the mistake that explains the difference, for example `axis x inverted?`.

        Empty where none does.
        """
        if len(self._pairs) < GYRO.fewest_compared:
            return ""
        # Without their means: a bias is no mistake.
        gyro, events = (
            np.array(part) - np.mean(part, axis=0) for part in zip(*self._pairs, strict=True)
        )
        ratio = math.sqrt(float((gyro**2).sum()) / max(float((events**2).sum()), 1e-12))
        if abs(ratio / _DEG - 1) < GYRO.units:
            return "readings in deg/s?"
        if abs(ratio * _DEG - 1) < GYRO.units:
            return "readings converted to rad/s twice?"

        def left(axes: Array) -> float:
            return float(((events - gyro @ axes.T) ** 2).sum())

        best = min(AXES, key=left)
        if left(best) > GYRO.better * left(np.eye(3)):
            return ""
        inverted = [axis for axis, sign in zip("xyz", np.diag(best), strict=True) if sign < 0]
        if np.abs(np.diag(best)).all():
            return f"{'axes' if len(inverted) > 1 else 'axis'} {', '.join(inverted)} inverted?"
        return f"the camera's axes are ({axis_names(best)}) of the readings?"
