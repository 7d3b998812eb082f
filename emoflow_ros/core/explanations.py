"""Motions that explain a flow, and what they cost.

A motion that leaves more of the flow unexplained costs more, and so does one of more flow: of two
motions that leave the same residuals, the one that has to turn and to travel less is likelier.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Variance of a node's flow that more events do not lessen, px^2 per window^2 (docs/method.md): of
# depth edges and of the lattice between its nodes.
_LASTING_PX2 = 0.6
_USUAL_MISFIT = 0.1  # median over windows
_LEAST_MISFIT, _MOST_MISFIT = 0.2, 5.0  # over the usual one


def trusted(information: Array) -> Array:
    """Inverse covariance of a measured flow from the contrast's curvature.

    Args:
        information: (nodes, 2, 2) curvature, px^-2. It grows with the number of events without a
            bound; the flow's error does not shrink like that.

    Returns:
        (nodes, 2, 2).
    """
    result: Array = np.linalg.solve(np.eye(2) + _LASTING_PX2 * information, information)
    return result


@dataclass(frozen=True)
class Explanations:
    """Constant motions, each the best one along its direction of travel.

    The costs are minus twice logarithms of a probability.

    Attributes:
        v: (M, 3) unit directions; zero for a camera that only turns.
        w: (M, 3) rad per window.
        residual: (M,) cost of what the motion leaves of the flow, and of other knowledge of w.
        size: (M,) cost of how much flow it takes, and of what was known before.
    """

    v: Array
    w: Array
    residual: Array
    size: Array

    @property
    def cost(self) -> Array:
        """Both costs (M,)."""
        return self.residual + self.size

    def at(self, k: int) -> "Explanations":
        """Take the k-th motion alone."""
        one = slice(k, k + 1)
        return Explanations(self.v[one], self.w[one], self.residual[one], self.size[one])


def temperature(
    here: Explanations, others: Explanations, usable: NDArray[np.bool_], information: Array
) -> float:
    """Tell by how much the residuals of a window are larger or smaller than usual.

    The error that lasts is not the same in every scene. The result is the geometric mean of what
    the window itself tells, by the least residual, and of what is usual, which is 1.

    Args:
        here: the motion that was fitted.
        others: other motions.
        usable: (nodes,) which nodes count.
        information: (nodes, 2, 2), inverse covariance of the flow, as `trusted` tells it.

    Returns:
        What all costs are to be divided by.
    """
    least = min(float(here.residual[0]), float(others.residual.min()))
    seen = 0.5 * _LASTING_PX2 * float(usable @ np.trace(information, axis1=1, axis2=2))
    misfit = least / max(seen, 1.0) / _USUAL_MISFIT
    return float(np.sqrt(np.clip(misfit, _LEAST_MISFIT, _MOST_MISFIT)))
