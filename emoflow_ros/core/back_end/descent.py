"""Levenberg and Marquardt's descent to the least cost of an adjustment, compiled."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment_kernels import (
    NODE,
    POSE,
    Equations,
    Observations,
    Unknowns,
    observation_cost,
    observe,
    rotated,
    share_of_depths,
)
from emoflow_ros.core.back_end.prior_kernels import Prior, motion_prior, prior_cost
from emoflow_ros.core.numerics.jit import njit

Array = NDArray[np.float64]
Index = NDArray[np.int64]

_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-7, 1e4
_LEAST_GAIN = 1e-4  # share of the cost by which a step that goes on must lower it
_REGULAR = 1e-9  # added to the diagonal
_AT_ONE_PLACE = 6  # unknowns of a node at most without its position and velocity

_compiled = njit(nogil=True)


@_compiled
def descend(
    o: Observations, start: Unknowns, prior: Prior, outlier: float, steps: int, free: Index,
    depths: tuple[float, float],
) -> tuple[Unknowns, float]:  # fmt: skip
    """Descend from a start to unknowns and their cost.

    Args:
        o: observations of at least one patch.
        start: where to begin.
        prior: of the motion.
        outlier: distance in standard deviations from which an observation counts little.
        steps: at most.
        free: (U,) unknowns of the nodes that are adjusted. Without the positions the camera is
            held at one place, and depths stay.
        depths: least and largest inverse depth.

    Raises:
        numpy.linalg.LinAlgError: the equations are not positive definite.
    """
    translates = len(free) > _AT_ONE_PLACE * len(start.position)
    squares, e = np.empty(len(o.patch)), _equations(o, start)
    x = start
    if not translates:
        x = Unknowns(
            x.rotation, np.zeros_like(x.position), x.angular, np.zeros_like(x.velocity),
            x.inverse_depth,
        )  # fmt: skip
    now, damping = _cost(o, x, prior, outlier, squares), _DAMPING
    for _ in range(steps):
        share, share_right = _linearise(o, x, prior, outlier, e)
        gained = 0.0
        while damping < _MOST_DAMPING:
            nodes, rho = _step(e, share, share_right, free, damping)
            after = _moved(x, nodes, rho, depths, translates)
            then = _cost(o, after, prior, outlier, squares)
            if then <= now:
                gained, x, now = now - then, after, then
                damping = max(damping / 5, _LEAST_DAMPING)
                break
            damping *= 5
        if gained < _LEAST_GAIN * now:
            break
    return x, now


@_compiled
def linearised(
    o: Observations, x: Unknowns, prior: Prior, outlier: float, free: Index
) -> tuple[Array, Array, Array]:
    """Squares (O,) of the observations over their variance, and normal equations at `descend`'s x.

    Returns:
        Squares, the equations (U, U) of the free unknowns, depths taken out, and the information
        (J,) on each depth along this way.
    """
    squares, e = np.empty(len(o.patch)), _equations(o, x)
    observation_cost(o, x, outlier, squares)
    share, share_right = _linearise(o, x, prior, outlier, e)
    _take(e.matrix, e.right, share, share_right, 1.0)
    return squares, _chosen(e.matrix, free), e.own


@_compiled
def information(o: Observations, x: Unknowns, outlier: float, free: Index) -> tuple[Array, Array]:
    """Normal equations (U, U), (U,) of the free unknowns without the prior of the motion.

    Depths are taken out, with what is known of them. Arguments as of `descend`.
    """
    e = _equations(o, x)
    _observe_anew(o, x, outlier, e)
    share, share_right = share_of_depths(e)
    _take(e.matrix, e.right, share, share_right, 1.0)
    return _chosen(e.matrix, free), e.right[free]


@_compiled
def _equations(o: Observations, x: Unknowns) -> Equations:
    """Room for equations."""
    poses, patches, size = POSE * len(x.position), len(o.anchor), NODE * len(x.position)
    return Equations(
        np.empty((size, size)), np.empty(size), np.empty((patches, poses)), np.empty(patches),
        np.empty(patches),
    )  # fmt: skip


@_compiled
def _cost(o: Observations, x: Unknowns, prior: Prior, outlier: float, squares: Array) -> float:
    """Cost of everything; squares (O,) of the observations are written."""
    return observation_cost(o, x, outlier, squares) + prior_cost(x, prior)


@_compiled
def _linearise(
    o: Observations, x: Unknowns, prior: Prior, outlier: float, e: Equations
) -> tuple[Array, Array]:
    """Set the equations up, and return what the depths take off them."""
    _observe_anew(o, x, outlier, e)
    motion_prior(x, prior, e.matrix, e.right)
    return share_of_depths(e)


@_compiled
def _observe_anew(o: Observations, x: Unknowns, outlier: float, e: Equations) -> None:
    """Set the equations up by the observations alone."""
    e.matrix[:], e.right[:], e.cross[:], e.own[:], e.own_right[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    observe(o, x, outlier, e)


@_compiled
def _take(matrix: Array, right: Array, share: Array, share_right: Array, factor: float) -> None:
    """Take a share of the poses (6 K, 6 K), (6 K,) off the nodes' (lower triangle)."""
    for k in range(len(share) // POSE):
        for a in range(POSE):
            u, s = NODE * k + a, POSE * k + a
            right[u] -= factor * share_right[s]
            for i in range(k + 1):
                for b in range(POSE):
                    matrix[u, NODE * i + b] -= factor * share[s, POSE * i + b]


@_compiled
def _step(
    e: Equations, share: Array, share_right: Array, free: Index, damping: float
) -> tuple[Array, Array]:
    """Solve for a damped step of the nodes (12 K,) and of the depths (J,)."""
    reduced, reduced_right = e.matrix.copy(), e.right.copy()
    _take(reduced, reduced_right, share, share_right, 1 / (1 + damping))
    small = _chosen(reduced, free)
    for a in range(len(free)):
        small[a, a] += damping * e.matrix[free[a], free[a]] + _REGULAR
    nodes, solved = np.zeros(len(e.right)), _solved(small, reduced_right[free])
    for a in range(len(free)):
        nodes[free[a]] = solved[a]
    poses = np.empty(e.cross.shape[1])
    for k in range(len(poses) // POSE):
        poses[POSE * k : POSE * (k + 1)] = nodes[NODE * k : NODE * k + POSE]
    return nodes, (e.own_right - e.cross @ poses) / (e.own * (1 + damping))


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
    x: Unknowns, nodes: Array, depth: Array, bounds: tuple[float, float], translates: bool
) -> Unknowns:
    """Add steps of the nodes (12 K,) and of the depths (J,), which stay without translation."""
    after = Unknowns(
        x.rotation.copy(), x.position.copy(), x.angular.copy(), x.velocity.copy(),
        x.inverse_depth.copy(),
    )  # fmt: skip
    for k in range(len(x.position)):
        step = nodes[NODE * k : NODE * (k + 1)]
        turned = rotated(x.rotation[k], step[:3])
        for i in range(3):
            after.position[k, i] += step[3 + i]
            after.angular[k, i] += step[POSE + i]
            after.velocity[k, i] += step[POSE + 3 + i]
            for j in range(3):
                after.rotation[k, i, j] = turned[i, j]
    if translates:
        for j in range(len(depth)):
            after.inverse_depth[j] = min(max(x.inverse_depth[j] + depth[j], bounds[0]), bounds[1])
    return after
