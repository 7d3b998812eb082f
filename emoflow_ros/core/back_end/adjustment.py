"""Robust adjustment of poses, velocities and inverse depths over a window of slices.

Levenberg and Marquardt's method on the normal equations without the depths (bundle adjustment:
Triggs et al., Vision Algorithms, 2000), with a motion prior of white noise on the accelerations.
The pose of the newest node is held: it is the common frame's.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from emoflow_ros.core.back_end.adjustment_kernels import (
    NODE,
    Observations,
    Unknowns,
    observation_cost,
    observe,
    turned,
    without_depths,
)
from emoflow_ros.core.back_end.prior_kernels import Prior, motion_prior
from emoflow_ros.core.back_end.settings import BackEndSettings

Array = NDArray[np.float64]

_DAMPING, _MOST_DAMPING = 1e-4, 1e4
_LEAST_GAIN = 1e-4  # share of the cost by which a step that goes on must lower it
_REGULAR = 1e-9  # added to the diagonal


@dataclass(frozen=True)
class Adjusted:
    """An adjustment.

    Attributes:
        x: the unknowns.
        cost: robust, with the priors.
        squares: (O,) of each observation, over the variance.
        matrix: (U, U) normal equations of the free unknowns of the nodes, depths taken out.
        free: (U,) which unknowns of the nodes these are.
        travels: False where the camera was held at one place.
    """

    x: Unknowns
    cost: float
    squares: Array
    matrix: Array
    free: NDArray[np.int64]
    travels: bool

    @cached_property
    def covariance(self) -> Array:
        """Covariance (U, U) of the free unknowns of the nodes, the depths being unknown, too.

        Raises:
            numpy.linalg.LinAlgError: the equations are not positive definite.
        """
        scale = 1 / np.sqrt(np.diag(self.matrix) + _REGULAR)
        factor = cho_factor(scale[:, None] * self.matrix * scale, check_finite=False)
        inverse = cho_solve(factor, np.diag(scale), check_finite=False)
        return np.asarray(scale[:, None] * inverse)

    def mean_cost(self, settings: BackEndSettings) -> float:
        """Robust cost of an observation on average, over what it is where all is right."""
        squares = self.squares / (1 + self.squares / settings.outlier**2)
        return 0.5 * float(squares.mean()) / settings.expected_cost

    def variance_factor(self, settings: BackEndSettings) -> float:
        """By how much squared errors exceed the covariance.

        Where many places do not fit, they are wrong together, which robust weights do not know.
        """
        return max(self.mean_cost(settings), settings.least_cost) ** 2


def adjust(
    observations: Observations, start: Unknowns, prior: Prior, outlier: float, steps: int,
    depths: tuple[float, float], *, travels: bool = True,
) -> Adjusted:  # fmt: skip
    """Adjust from a start.

    Args:
        observations: of at least one patch.
        start: where to begin.
        prior: of the motion.
        outlier: distance in standard deviations from which an observation counts little.
        steps: at most.
        depths: least and largest inverse depth.
        travels: whether the camera may move from its place, or turns only.

    Raises:
        numpy.linalg.LinAlgError: the equations are not positive definite, or nothing is finite.
    """
    free = _free(len(start.position), travels)
    squares = np.empty(len(observations.patch))
    nothing = np.empty((0, 0)), np.empty(0)

    def cost(x: Unknowns) -> float:
        total = observation_cost(observations, x, outlier, squares)
        return total + motion_prior(x, prior, *nothing, False)

    x, damping, now = start, _DAMPING, cost(start)
    if not travels:
        x = x._replace(position=np.zeros_like(x.position), velocity=np.zeros_like(x.velocity))
        now = cost(x)
    for _ in range(steps):
        equations = _linearise(observations, x, prior, outlier)
        gained = 0.0
        while damping < _MOST_DAMPING:
            after = _moved(x, _solve(*equations, free, damping), depths if travels else None)
            then = cost(after)
            if then <= now:
                gained, x, now = now - then, after, then
                damping = max(damping / 5, 1e-7)
                break
            damping *= 5
        if gained < _LEAST_GAIN * now:
            break
    equations = _linearise(observations, x, prior, outlier)
    without_depths(*equations)
    now = cost(x)  # writes the squares
    if not np.isfinite(now):
        raise np.linalg.LinAlgError("the cost is not finite")
    return Adjusted(x, now, squares, equations[0][np.ix_(free, free)], free, travels)


def _free(nodes: int, travels: bool) -> NDArray[np.int64]:
    """Indices of the unknowns that are adjusted: not the newest pose."""
    unknown = np.ones((nodes, NODE), np.bool_)
    unknown[-1, :6] = False
    if not travels:
        unknown[:, 3:6] = unknown[:, 9:] = False
    return np.flatnonzero(unknown)


def _linearise(
    observations: Observations, x: Unknowns, prior: Prior, outlier: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Normal equations of nodes and depths: matrix, right side, cross, and those of the depths."""
    size, patches = NODE * len(x.position), len(observations.anchor)
    matrix, right = np.zeros((size, size)), np.zeros(size)
    cross, depth_matrix, depth_right = (
        np.zeros((patches, size)),
        np.zeros(patches),
        np.zeros(patches),
    )
    observe(observations, x, outlier, matrix, right, cross, depth_matrix, depth_right)
    motion_prior(x, prior, matrix, right, True)
    return matrix, right, cross, depth_matrix, depth_right


def _solve(
    matrix: Array, right: Array, cross: Array, depth_matrix: Array, depth_right: Array,
    free: NDArray[np.int64], damping: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Solve for a damped step of the nodes (12 K,) and of the depths (J,)."""
    damped = depth_matrix * (1 + damping)
    reduced, reduced_right = matrix.copy(), right.copy()
    without_depths(reduced, reduced_right, cross, damped, depth_right)
    small = reduced[np.ix_(free, free)]
    small[np.diag_indices_from(small)] += damping * np.diag(matrix)[free] + _REGULAR
    step = np.zeros(len(right))
    step[free] = cho_solve(
        cho_factor(small, check_finite=False), reduced_right[free], check_finite=False
    )
    return step, (depth_right - cross @ step) / damped


def _moved(x: Unknowns, step: tuple[Array, Array], depths: tuple[float, float] | None) -> Unknowns:
    """Add a step to the unknowns; without bounds of the depths these stay."""
    nodes = step[0].reshape(-1, NODE)
    rotation = np.stack([turned(r, s) for r, s in zip(x.rotation, nodes[:, :3], strict=True)])
    depth = x.inverse_depth
    if depths is not None:
        depth = np.clip(depth + step[1], *depths)
    return Unknowns(
        rotation, x.position + nodes[:, 3:6], x.angular + nodes[:, 6:9],
        x.velocity + nodes[:, 9:], depth,
    )  # fmt: skip
