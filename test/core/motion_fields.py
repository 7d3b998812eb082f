"""Motion fields of random motions at the nodes of a lattice, behind three lenses."""

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.constraints import along_lines
from emoflow_ros.core.lattice.egomotion import Residuals
from emoflow_ros.core.lattice.field import Lattice

LENSES = {
    "none": (),
    "plumb_bob": (-0.34, 0.14, 0.0004, -0.0003),
    "equidistant": (-0.048, 0.0113, -0.0554, 0.0215),
}
LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
INLIER_PX = 0.7
MOTIONS = 100  # for each lens
CERTAIN = np.tile(np.eye(2), (NODES, 1, 1))
EXACT = 1e4 * CERTAIN  # so much that the size of the flow does not count beside it


def camera_with(lens: str) -> Camera:
    return Camera(346, 260, 226.4, 226.2, 173.6, 133.7, lens, LENSES[lens])


def random_motions(seed):
    """Unit v, w (some degrees per window) and inverse depths in 1 / windows."""
    rng = np.random.default_rng(seed)
    for _ in range(MOTIONS):
        v = rng.normal(size=3)
        depth = np.exp(rng.uniform(np.log(7), np.log(28), NODES))
        yield v / np.linalg.norm(v), rng.normal(scale=0.02, size=3), 1 / depth


def motion_field(epipolar, v, w, inverse_depth):
    return inverse_depth[:, None] * (epipolar.a @ v) + epipolar.b @ w


def structure_residuals(epipolar, flow, motion, inverse_depth) -> Residuals:
    """The flow along the epipolar lines against a known depth."""
    found = Residuals.empty(*flow.shape[:2])
    along_lines(
        *epipolar.kernel_arguments(flow, motion), motion.speed, inverse_depth,
        found.r, found.by_flow, found.by_motion,
    )  # fmt: skip
    return found


def with_outliers(flow, rng):
    """Every fifth node sees something else that moves."""
    flow = flow.copy()
    bad = rng.permutation(NODES)[: NODES // 5]
    flow[bad] += rng.normal(scale=10, size=(len(bad), 2))
    return flow


def angle(a, b):
    return np.degrees(np.arccos(np.clip(abs(a @ b), 0, 1)))
