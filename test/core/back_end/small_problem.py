"""A small adjustment with a known answer, for the tests of this folder."""

import numpy as np

from emoflow_ros.core.back_end.adjustment_kernels import Observations, Unknowns
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.trajectory import along

NODES, PATCHES, NOISE = 5, 30, 5e-4
T = np.arange(NODES) * 40_000_000
DEPTHS = (0.01, 20.0)
W, V = np.array([0.1, -0.2, 0.05]), np.array([0.3, 0.1, 0.2])
NOT_ROBUST = 1e6  # standard deviations


def truth() -> Unknowns:
    rng = np.random.default_rng(1)
    return along(T, np.tile(W, (NODES, 1)), np.tile(V, (NODES, 1)), rng.uniform(0.5, 1.6, PATCHES))


def seen_by(x: Unknowns, bearing: np.ndarray, anchor: int, node: int) -> np.ndarray:
    rays = np.concatenate([bearing, np.ones((len(bearing), 1))], axis=1)
    common = rays @ x.rotation[anchor].T
    common = common + x.inverse_depth[:, None] * (x.position[anchor] - x.position[node])
    inside = common @ x.rotation[node]
    return inside[:, :2] / inside[:, 2:]


def problem(noise: float = NOISE, seed: int = 2) -> Observations:
    rng, x = np.random.default_rng(seed), truth()
    bearing = rng.uniform(-0.6, 0.6, (PATCHES, 2))
    patch, node = (a.ravel() for a in np.meshgrid(np.arange(PATCHES), np.arange(1, NODES)))
    seen = np.concatenate([seen_by(x, bearing, 0, k) for k in range(1, NODES)])
    seen = seen + noise * rng.normal(size=seen.shape)
    root = np.tile(np.eye(2) / NOISE, (len(patch), 1, 1))
    return Observations(
        patch, node, seen, root, np.zeros(PATCHES, np.int64), bearing,
        np.ones(PATCHES), np.ones(PATCHES),
    )  # fmt: skip


def prior(walk: float = 0.5, velocity_walk: float = 1.0) -> Prior:
    return Prior(
        np.diff(T) * 1e-9, walk**2, velocity_walk**2, 2.0,
        np.zeros((0, 3)), np.zeros((0, NODES)), np.zeros((0, 3, 3)), 20.0,
        np.zeros(0, np.bool_), np.eye(3),
    )  # fmt: skip


def start() -> Unknowns:
    nothing = np.zeros((NODES, 3))
    return along(T, nothing, nothing + np.array([0.1, 0.0, 0.1]), np.ones(PATCHES))
