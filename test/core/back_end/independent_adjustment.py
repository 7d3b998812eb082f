"""The adjustment of the small problem written down once more, for SciPy's least squares."""

from itertools import pairwise

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation
from small_problem import NODES, NOISE, NOT_ROBUST, PATCHES, prior, problem, seen_by, start

from emoflow_ros.core.back_end.adjustment_kernels import NODE, Observations, Unknowns, rotated
from emoflow_ros.core.back_end.prior_kernels import Prior


def residuals(free: np.ndarray, o: Observations, p: Prior) -> np.ndarray:
    """All residuals of a vector of unknowns about the start, written down independently.

    The last three are a gyro's bias, where a gyro measures.
    """
    begin, bias = start(), np.zeros(3)
    if p.measured_biased.any():
        free, bias = free[:-3], free[-3:]
    nodes = np.zeros((NODES, NODE))
    index = np.ones((NODES, NODE), np.bool_)
    index[-1, :6] = False
    nodes[index] = free[: index.sum()]
    rotation = np.stack([rotated(r, n[:3]) for r, n in zip(begin.rotation, nodes, strict=True)])
    x = Unknowns(
        rotation, begin.position + nodes[:, 3:6], begin.angular + nodes[:, 6:9],
        begin.velocity + nodes[:, 9:], begin.inverse_depth + free[index.sum() :],
    )  # fmt: skip
    rows = []
    for k in range(1, NODES):
        of_node = o.node == k
        rows.append((seen_by(x, o.bearing, 0, k) - o.seen[of_node]).ravel() / NOISE)
    for k, dt in enumerate(p.seconds):
        turn = Rotation.from_matrix(x.rotation[k].T @ x.rotation[k + 1]).as_rotvec()
        noise = np.linalg.cholesky(np.linalg.inv([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
        for density, way, change in (
            (p.angular_walk, turn - dt * x.angular[k], x.angular[k + 1] - x.angular[k]),
            (
                p.velocity_walk,
                x.position[k + 1] - x.position[k] - dt * x.velocity[k],
                x.velocity[k + 1] - x.velocity[k],
            ),
        ):
            rows.append((noise.T @ np.stack([way, change]) / np.sqrt(density)).ravel())
    turns = [r.T @ after for r, after in pairwise(x.rotation)]
    rates = Rotation.from_matrix(turns).as_rotvec() / p.seconds[:, None]
    means = p.measured_share @ np.concatenate([rates, x.angular[-1:]])
    means = means + p.measured_biased[:, None] * bias
    rows.append(np.einsum("mij,mj->mi", p.measured_root, means - p.measured).ravel())
    rows.append(np.linalg.cholesky(p.bias_information).T @ bias)
    rows += [(x.velocity / p.speed_sd).ravel(), (x.inverse_depth - o.depth_mean) / o.depth_sd]
    return np.concatenate(rows)


def with_windows(outlier: float) -> Prior:
    """Windows from the second node to the fourth, and from the third until after the newest."""
    share = np.array([[0.0, 0.5, 0.5, 0.0, 0.0], [0.0, 0.0, 0.3, 0.4, 0.3]])
    rates = np.array([[0.3, -0.1, 0.0], [0.2, 0.0, -0.1]])
    root = np.array([np.eye(3) / 0.02, [[40.0, 10.0, 0.0], [0.0, 60.0, 5.0], [0.0, 0.0, 50.0]]])
    return prior()._replace(
        measured=rates, measured_share=share, measured_root=root, measured_outlier=outlier,
        measured_biased=np.zeros(2, np.bool_),
    )  # fmt: skip


def with_gyro() -> Prior:
    """The same windows by a gyro whose bias is known to 0.1 rad/s, and one more of the lattice."""
    known = with_windows(NOT_ROBUST)
    again = {name: getattr(known, name)[[0, 1, 0]] for name in ("measured_share", "measured_root")}
    return known._replace(
        **again,
        measured=known.measured[[0, 1, 0]] + 0.15 * np.array([[1.0], [1.0], [0.0]]),
        measured_biased=np.array([True, True, False]),
        bias_information=np.diag([100.0, 120.0, 80.0]),
    )


def best_by_scipy(known: Prior) -> tuple[OptimizeResult, np.ndarray]:
    """The optimum, and the covariance of all unknowns."""
    count = NODES * NODE - 6 + PATCHES + 3 * bool(known.measured_biased.any())
    best = least_squares(residuals, np.zeros(count), args=(problem(), known), x_scale="jac")
    return best, np.linalg.inv(best.jac.T @ best.jac)
