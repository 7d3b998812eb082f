"""A second look at a window: a fit of its flow that knows nothing of the estimate.

A contrast has many local maxima at full resolution, and the epipolar constraint can hold the flow
at one that the events do not support. A fresh fit by the events alone, from coarse to fine, goes
elsewhere then; where the events leave no doubt it comes out close by.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.contrast import ImageContrast, WindowEvents
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.normal_equations import NormalEquations

F32 = NDArray[np.float32]

_ALL = 1_000_000_000
# Scale of the image, number of events, steps. With a part of the events in the last ones the
# distance from the estimate says less about its error; full resolution adds nothing.
_STEPS = ((0.25, 2_000, 5), (0.5, _ALL, 2))


class SecondLook:
    """Fits flows without the epipolar constraint.

    Args:
        lattice: of the flow.
        contrasts: by the scale of the image.
        config: for the smoothness.
    """

    def __init__(
        self, lattice: Lattice, contrasts: Mapping[float, ImageContrast], config: LatticeConfig
    ) -> None:
        self._equations = NormalEquations(lattice, 0)
        self._contrasts = contrasts
        self._config = config

    def flow(self, events: WindowEvents, start: F32) -> F32:
        """Fit the flow (columns, rows, times, 2), px per window.

        Args:
            events: of the window.
            start: a constant flow.

        Raises:
            NotPositiveDefiniteError: the events have no best flow.
        """
        equations, flow = self._equations, start
        for scale, number, steps in _STEPS:
            few = events.every(max(1, len(events) // number))
            for _ in range(steps):
                equations.clear()
                self._contrasts[scale].linearise(few, flow, equations.vector, equations.band)
                equations.add_smoothness(flow, self._config)
                flow = (flow + equations.solve().reshape(flow.shape)).astype(np.float32)
        return flow


def distance(one: F32, other: F32, evidence: NDArray[np.float64]) -> float:
    """Return how far two flows lie apart: the root mean square over the evidence, px per window.

    Args:
        one, other: (columns, rows, times, 2), px per window.
        evidence: (nodes,) how much the events say about the flow at each node.
    """
    apart = (one - other).mean(axis=2).reshape(-1, 2).astype(np.float64)
    squares = (apart**2).sum(axis=1)
    return float(np.sqrt(evidence @ squares / max(float(evidence.sum()), 1e-9)))
