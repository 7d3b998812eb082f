"""How far a motion rests on a part of the patches: the jackknife.

Errors of neighbouring places go together: of edges that are taken for others, depths that are
mixed up, things that move by themselves. Normal equations do not know that. Adjustments that do
without a quarter of the patches do (Tukey, Annals of Mathematical Statistics 29, 1958; with blocks:
Künsch, Annals of Statistics 17, 1989). What moves by itself before a camera that turns looks like
something near that the camera travels past; the farther patches know better.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from emoflow_ros.core.back_end.adjustment import Adjusted
from emoflow_ros.core.back_end.adjustment_kernels import NODE, POSE, Observations, Unknowns
from emoflow_ros.core.back_end.descent import descend, information
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import angles_across, between, interpolated, mixed

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Times = NDArray[np.int64]

_QUARTERS = 4


@dataclass(frozen=True)
class ByParts:
    """What parts of the patches make of a motion.

    Attributes:
        changes: (K, 4, 3) rad/s, of the angular velocity at the nodes without each quarter.
        farther: the way by the farther half alone, without depths; None of a camera that only
            rotates, or where the adjustment diverges.
    """

    changes: Array
    farther: Unknowns | None

    @classmethod
    def of(
        cls, problem: Observations, found: Adjusted, known: Prior, settings: BackEndSettings
    ) -> "ByParts":
        """Adjust to parts of what a motion was adjusted to.

        Args:
            problem: the places of all patches.
            found: adjusted to them.
            known: of the motion.
            settings: of the back end.
        """
        changes = without_quarters(problem, found, settings)
        return cls(changes, by_farther(problem, found, known, settings))

    def spread(self, times: Times, t: int, linear: Array) -> tuple[Array, Array]:
        """How far the motion rests on parts at a time (ns).

        Args:
            times: (K,) ns of the nodes.
            t: ns.
            linear: (3,) its velocity then, in the camera's frame.

        Returns:
            Covariances (3, 3) of the angular velocity, rad^2/s^2, and of the direction of
            translation, rad^2.
        """
        of_w, of_v = spread(mixed(self.changes, *between(times, t))), np.zeros((3, 3))
        if self.farther is not None:
            apart = angles_across(linear, interpolated(times, self.farther, t)[1])
            # Of two that are as good, each has half the variance of their difference.
            of_v = 0.5 * np.outer(apart, apart)
        return of_w, of_v


def by_farther(
    problem: Observations, found: Adjusted, known: Prior, settings: BackEndSettings
) -> Unknowns | None:
    """Adjust the way to the half of the patches that are farther. Arguments as in `ByParts.of`.

    Returns:
        None of a camera that only rotates, or where it diverges.
    """
    if not found.translates:
        return None
    depths = found.x.inverse_depth
    far = depths <= np.median(depths)
    own, number = far[problem.patch], np.cumsum(far) - 1
    half = Observations(
        number[problem.patch[own]],
        problem.node[own], problem.seen[own], problem.root[own],
        problem.anchor[far], problem.bearing[far], problem.depth_mean[far], problem.depth_sd[far],
    )  # fmt: skip
    start = found.x._replace(inverse_depth=depths[far])
    with suppress(np.linalg.LinAlgError):
        x, cost = descend(
            half, start, known, settings.outlier, settings.steps, found.free, settings.depths
        )
        if np.isfinite(cost):
            return x._replace(inverse_depth=np.zeros(0))
    return None


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
