"""Robust adjustment of poses, velocities and inverse depths over a window of slices.

Levenberg and Marquardt's method on the normal equations without the depths (bundle adjustment:
Triggs et al., Vision Algorithms, 2000), with a motion prior of white noise on the accelerations.
The pose of the newest node is held: it is the common frame's.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from emoflow_ros.core.back_end.adjustment_kernels import NODE, Observations, Unknowns
from emoflow_ros.core.back_end.descent import descend, linearised
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings

Array = NDArray[np.float64]

_REGULAR = 1e-9  # added to the diagonal
_RESCALE = (0.5, 2.0)  # by how much at most


@dataclass(frozen=True)
class Adjusted:
    """An adjustment.

    Attributes:
        x: the unknowns.
        cost: robust, with the priors.
        squares: (O,) of each observation, over the variance.
        matrix: (U, U) normal equations of the free unknowns of the nodes, depths taken out.
        free: (U,) which unknowns of the nodes these are.
        translates: False where the camera was held at one place.
        of_depth: (J,) information on each patch's inverse depth by its places, along this way.
    """

    x: Unknowns
    cost: float
    squares: Array
    matrix: Array
    free: NDArray[np.int64]
    translates: bool
    of_depth: Array

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

    def of_unit_depth(self) -> "Adjusted":
        """The same with the scene scaled so that its median inverse depth is one."""
        x, scale = of_unit_depth(self.x)
        # in the order of a node's unknowns
        by_kind = np.repeat([1.0, 1 / scale, 1.0, 1 / scale], 3)
        factor = np.tile(by_kind, len(x.position))[self.free]
        matrix = factor[:, None] * self.matrix * factor
        return replace(self, x=x, matrix=matrix, of_depth=scale**2 * self.of_depth)


def of_unit_depth(x: Unknowns) -> tuple[Unknowns, float]:
    """Scale the scene so that its median inverse depth is one; return the scale, too."""
    scale = float(np.clip(np.median(x.inverse_depth), *_RESCALE))
    x = x._replace(
        position=scale * x.position,
        velocity=scale * x.velocity,
        inverse_depth=x.inverse_depth / scale,
    )
    return x, scale


def adjust(
    observations: Observations, start: Unknowns, prior: Prior, outlier: float, steps: int,
    depths: tuple[float, float], *, translates: bool = True,
) -> Adjusted:  # fmt: skip
    """Adjust from a start.

    Args:
        observations: of at least one patch.
        start: where to begin.
        prior: of the motion.
        outlier: distance in standard deviations from which an observation counts little.
        steps: at most.
        depths: least and largest inverse depth.
        translates: whether the camera may move from its place, or rotates only.

    Raises:
        numpy.linalg.LinAlgError: the equations are not positive definite, or nothing is finite.
    """
    free = free_unknowns(len(start.position), translates=translates)
    x, cost = descend(observations, start, prior, outlier, steps, free, depths)
    if not np.isfinite(cost):
        raise np.linalg.LinAlgError("the cost is not finite")
    squares, matrix, of_depth = linearised(observations, x, prior, outlier, free)
    of_depth -= 1 / observations.depth_sd**2
    return Adjusted(x, cost, squares, matrix, free, translates, of_depth)


def free_unknowns(nodes: int, *, translates: bool) -> NDArray[np.int64]:
    """Indices of the unknowns that are adjusted: not the newest pose."""
    unknown = np.ones((nodes, NODE), np.bool_)
    unknown[-1, :6] = False
    if not translates:
        unknown[:, 3:6] = unknown[:, 9:] = False
    return np.flatnonzero(unknown)
