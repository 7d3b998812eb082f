"""Levenberg and Marquardt's descent to the least cost of an adjustment, compiled."""

import numpy as np
from numpy.typing import NDArray

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
from emoflow_ros.core.jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-7, 1e4
_LEAST_GAIN = 1e-4  # share of the cost by which a step that goes on must lower it
_REGULAR = 1e-9  # added to the diagonal
_AT_ONE_PLACE = 6  # unknowns of a node at most without its position and velocity

_compiled = njit(fastmath={"reassoc", "contract", "arcp", "nsz"}, nogil=True)


@_compiled
def descend(
    o: Observations, start: Unknowns, prior: Prior, outlier: float, steps: int, free: Index,
    depths: tuple[float, float],
) -> tuple[Unknowns, float, Array, Array]:  # fmt: skip
    """Descend from a start.

    Args:
        o: observations of at least one patch.
        start: where to begin.
        prior: of the motion.
        outlier: distance in standard deviations from which an observation counts little.
        steps: at most.
        free: (U,) unknowns of the nodes that are adjusted. Without the positions the camera is
            held at one place, and depths stay.
        depths: least and largest inverse depth.

    Returns:
        Unknowns, their cost, squares (O,) of the observations over their variance, and normal
        equations (U, U) of the free unknowns, depths taken out.

    Raises:
        numpy.linalg.LinAlgError: the equations are not positive definite.
    """
    travels = len(free) > _AT_ONE_PLACE * len(start.position)
    size, patches = NODE * len(start.position), len(o.anchor)
    squares = np.empty(len(o.patch))
    matrix, right = np.zeros((size, size)), np.zeros(size)
    cross, own, own_right = np.zeros((patches, size)), np.zeros(patches), np.zeros(patches)
    x = start
    if not travels:
        x = Unknowns(
            x.rotation, np.zeros_like(x.position), x.angular, np.zeros_like(x.velocity),
            x.inverse_depth,
        )  # fmt: skip
    now = observation_cost(o, x, outlier, squares) + motion_prior(x, prior, matrix, right, False)
    damping = _DAMPING
    for _ in range(steps):
        matrix[:], right[:], cross[:], own[:], own_right[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        observe(o, x, outlier, matrix, right, cross, own, own_right)
        motion_prior(x, prior, matrix, right, True)
        gained = 0.0
        while damping < _MOST_DAMPING:
            nodes, rho = _step(matrix, right, cross, own, own_right, free, damping)
            after = _moved(x, nodes, rho, depths, travels)
            then = observation_cost(o, after, outlier, squares)
            then += motion_prior(after, prior, matrix, right, False)
            if then <= now:
                gained, x, now = now - then, after, then
                damping = max(damping / 5, _LEAST_DAMPING)
                break
            damping *= 5
        if gained < _LEAST_GAIN * now:
            break
    matrix[:], right[:], cross[:], own[:], own_right[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    observe(o, x, outlier, matrix, right, cross, own, own_right)
    motion_prior(x, prior, matrix, right, True)
    without_depths(matrix, right, cross, own, own_right)
    now = observation_cost(o, x, outlier, squares) + motion_prior(x, prior, matrix, right, False)
    return x, now, squares, _chosen(matrix, free)


@_compiled
def _step(
    matrix: Array, right: Array, cross: Array, own: Array, own_right: Array, free: Index,
    damping: float,
) -> tuple[Array, Array]:  # fmt: skip
    """Solve for a damped step of the nodes (12 K,) and of the depths (J,)."""
    damped = own * (1 + damping)
    reduced, reduced_right = matrix.copy(), right.copy()
    without_depths(reduced, reduced_right, cross, damped, own_right)
    small = _chosen(reduced, free)
    for a in range(len(free)):
        small[a, a] += damping * matrix[free[a], free[a]] + _REGULAR
    nodes = np.zeros(len(right))
    nodes[free] = _solved(small, reduced_right[free])
    return nodes, (own_right - cross @ nodes) / damped


@_compiled
def _chosen(lower: Array, free: Index) -> Array:
    """Rows and columns of a symmetric matrix, of which the lower triangle is given."""
    out = np.empty((len(free), len(free)))
    for a in range(len(free)):
        for b in range(a + 1):
            out[a, b] = out[b, a] = lower[free[a], free[b]]
    return out


@_compiled
def _solved(matrix: Array, right: Array) -> Array:
    """Solve with a positive definite matrix."""
    factor = np.linalg.cholesky(matrix)
    out = right.copy()
    for a in range(len(out)):
        for b in range(a):
            out[a] -= factor[a, b] * out[b]
        out[a] /= factor[a, a]
    for a in range(len(out) - 1, -1, -1):
        out[a] /= factor[a, a]
        for b in range(a):
            out[b] -= factor[a, b] * out[a]
    return out


@_compiled
def _moved(
    x: Unknowns, nodes: Array, depth: Array, bounds: tuple[float, float], travels: bool
) -> Unknowns:
    """Add steps of the nodes (12 K,) and of the depths (J,), which stay without travel."""
    step = nodes.reshape(len(x.position), NODE)
    rotation = np.empty_like(x.rotation)
    for k in range(len(rotation)):
        rotation[k] = turned(x.rotation[k], step[k, :3])
    rho = x.inverse_depth
    if travels:
        rho = np.minimum(np.maximum(rho + depth, bounds[0]), bounds[1])
    return Unknowns(
        rotation, x.position + step[:, 3:6], x.angular + step[:, 6:9], x.velocity + step[:, 9:], rho
    )
