"""Whether the fit follows the motion within its window."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.contrast import ImageContrast, WindowEvents
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.normal_equations import NormalEquations

F32 = NDArray[np.float32]

_THIRD = 1 / 3  # of a window
_FEW_EVENTS = 300  # tell nothing about a third
_EVENTS = 3_000  # are enough at low resolution


class MotionChange:
    """Measures how far the ends of a window move off its fitted flow.

    Args:
        lattice: of the flow.
        contrast: at a low resolution, whose maxima are wide.
    """

    def __init__(self, lattice: Lattice, contrast: ImageContrast) -> None:
        self._equations = NormalEquations(lattice, 0)
        self._contrast = contrast

    def measure(self, events: WindowEvents, flow: F32) -> float:
        """Return how far the first or the last third of the window moves off the flow, px.

        One Newton step on the contrast of the third's events alone, for a velocity that the whole
        image shares; the larger of the two displacements within a third.

        Args:
            events: of the window.
            flow: (columns, rows, times, 2) px per window.
        """
        return max(self._shift(events, flow, begin) for begin in (0.0, 1 - _THIRD))

    def _shift(self, events: WindowEvents, flow: F32, begin: float) -> float:
        part = events.between(begin, begin + _THIRD)
        if len(part) < _FEW_EVENTS:
            return 0.0
        few = part.every(max(1, len(part) // _EVENTS))
        equations = self._equations
        equations.clear()
        self._contrast.linearise(few, flow, equations.vector, equations.band, begin + _THIRD / 2)
        force, stiffness = equations.of_common_shift()
        regular = stiffness + 1e-6 * (1 + np.trace(stiffness)) * np.eye(2)
        return float(np.linalg.norm(np.linalg.solve(regular, force))) * _THIRD
