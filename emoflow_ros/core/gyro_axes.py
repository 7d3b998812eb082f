"""Axes of a gyro that are turned by right angles, or mirrored, and how to name the mistake."""

import math
from collections import deque
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNITS = 0.35  # relative error of a scale up to which it looks like wrong units
_DEG = math.degrees(1.0)
_KEPT = 60
_FEW = 8
_BETTER = 0.5  # other axes have to leave less than this of what the given ones leave

# All 48 matrices of permuted and mirrored axes.
AXES: list[Array] = [
    np.diag(signs) @ np.eye(3)[list(order)]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
]


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
        self._pairs: deque[tuple[Array, Array]] = deque(maxlen=_KEPT)

    def add(self, gyro: Array, events: Array) -> None:
        """Take a window's angular velocities (3,), rad/s, of both; the gyro's with its bias."""
        self._pairs.append((gyro, events))

    def in_words(self) -> str:
        """Name the mistake that explains the difference, for example `axis x inverted?`.

        Empty where none does.
        """
        if len(self._pairs) < _FEW:
            return ""
        # Without their means: a bias is no mistake.
        gyro, events = (
            np.array(part) - np.mean(part, axis=0) for part in zip(*self._pairs, strict=True)
        )
        ratio = math.sqrt(float((gyro**2).sum()) / max(float((events**2).sum()), 1e-12))
        if abs(ratio / _DEG - 1) < UNITS:
            return "readings in deg/s?"
        if abs(ratio * _DEG - 1) < UNITS:
            return "readings converted to rad/s twice?"

        def left(axes: Array) -> float:
            return float(((events - gyro @ axes.T) ** 2).sum())

        best = min(AXES, key=left)
        if left(best) > _BETTER * left(np.eye(3)):
            return ""
        inverted = [axis for axis, sign in zip("xyz", np.diag(best), strict=True) if sign < 0]
        if np.abs(np.diag(best)).all():
            return f"{'axes' if len(inverted) > 1 else 'axis'} {', '.join(inverted)} inverted?"
        return f"the camera's axes are ({axis_names(best)}) of the readings?"
