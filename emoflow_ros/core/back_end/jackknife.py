"""How far a rotation rests on one part of the image: the jackknife.

Errors of neighbouring places go together: of edges that are taken for others, depths that are
mixed up, things that move by themselves. Normal equations do not know that. Adjustments that do
without a quarter of the patches do (Tukey, Annals of Mathematical Statistics 29, 1958; with blocks:
Künsch, Annals of Statistics 17, 1989).
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from emoflow_ros.core.back_end.adjustment import Adjusted
from emoflow_ros.core.back_end.adjustment_kernels import NODE, POSE, Observations
from emoflow_ros.core.back_end.descent import information
from emoflow_ros.core.back_end.settings import BackEndSettings

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_QUARTERS = 4


def without_quarters(problem: Observations, found: Adjusted, settings: BackEndSettings) -> Array:
    """Change of the angular velocities (K, 4, 3), rad/s, if a quarter of the patches is left out.

    That of one step of Gauss and Newton's, which goes two thirds of the way: the equations of all,
    whose right side is zero at the minimum, less those of a quarter, are those of the others. It is
    zero for a quarter without which there is no minimum.

    Args:
        problem: the places of all.
        found: adjusted to them.
        settings: of the back end.
    """
    quarter, nodes = quarters(problem.bearing)[problem.patch], len(found.x.position)
    changes = np.zeros((nodes, _QUARTERS, 3))
    for part in range(_QUARTERS):
        own = quarter == part
        some = problem._replace(
            patch=problem.patch[own], node=problem.node[own], seen=problem.seen[own],
            root=problem.root[own],
        )  # fmt: skip
        matrix, right = information(some, found.x, settings.outlier, found.free)
        step = np.zeros(nodes * NODE)
        with suppress(np.linalg.LinAlgError, ValueError):  # the latter if they are not finite
            step[found.free] = cho_solve(cho_factor(found.matrix - matrix), -right)
        changes[:, part] = step.reshape(nodes, NODE)[:, POSE : POSE + 3]
    return changes


def spread(changes: Array) -> Array:
    """Covariance (3, 3) of what changed by (4, 3) without each quarter."""
    return np.asarray((1 - 1 / _QUARTERS) * changes.T @ changes)


def quarters(bearing: Array) -> Index:
    """Number patches at bearings (J, 2) by four parts of the image that hold as many each."""
    right = bearing[:, 0] > np.median(bearing[:, 0])
    quarter = 2 * right.astype(np.int64)
    for side in (right, ~right):
        if side.any():
            quarter[side] += bearing[side, 1] > np.median(bearing[side, 1])
    return quarter
