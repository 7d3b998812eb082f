"""How far a rotation rests on one part of the image: the jackknife.

Errors of neighbouring places go together: of edges that are taken for others, depths that are
mixed up, things that move by themselves. Normal equations do not know that. Adjustments that do
without a quarter of the patches do (Tukey, Annals of Mathematical Statistics 29, 1958; with blocks:
Künsch, Annals of Statistics 17, 1989).
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment import Adjusted, free_unknowns
from emoflow_ros.core.back_end.adjustment_kernels import Observations
from emoflow_ros.core.back_end.descent import descend
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_QUARTERS = 4
_STEPS = 2  # the start is nearly the minimum


def without_quarters(
    problem: Observations, found: Adjusted, prior: Prior, settings: BackEndSettings
) -> Array:
    """Change of the angular velocities (K, 4, 3), rad/s, if a quarter of the patches is left out.

    It is zero for a quarter without which there is no minimum.

    Args:
        problem: the places of all.
        found: adjusted to them.
        prior: of the motion.
        settings: of the back end.
    """
    quarter = quarters(problem.bearing)[problem.patch]
    free = free_unknowns(len(found.x.position), translates=found.translates)

    def change(left_out: int) -> Array:
        kept = quarter != left_out
        others = problem._replace(
            patch=problem.patch[kept], node=problem.node[kept], seen=problem.seen[kept],
            root=problem.root[kept],
        )  # fmt: skip
        try:
            x, _ = descend(others, found.x, prior, settings.outlier, _STEPS, free, settings.depths)
        except np.linalg.LinAlgError:
            return np.zeros_like(found.x.angular)
        return x.angular - found.x.angular

    with ThreadPoolExecutor(2) as workers:
        return np.stack(list(workers.map(change, range(_QUARTERS))), axis=1)


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
