import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.constraints import add_constraint, add_structure
from emoflow_ros.core.lattice.egomotion import MOTION_UNKNOWNS, Motion, NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.fit import LatticeFit
from emoflow_ros.core.lattice.known import INFORMATION_EXCESS, Structure
from emoflow_ros.core.lattice.memory import Memory
from emoflow_ros.core.lattice.normal_equations import NormalEquations
from emoflow_ros.core.types.estimate import MotionModel
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window

CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7)
LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
V = np.array([0.8, 0.0, 0.6])
OF_V = np.r_[3:6, 9:12]


@pytest.fixture
def fit() -> LatticeFit:
    """A scene at one depth that passes along V, but for every tenth node."""
    config = load_config("realtime").estimator
    epipolar = NodeEpipolar(CAMERA, LATTICE, config.dec_inlier_px)
    made = LatticeFit(LATTICE, epipolar, config)
    flow = 0.05 * (epipolar.a @ V)
    flow[::10] *= -1
    made.flow = np.repeat(flow[:, None], LATTICE.times, 1).reshape(LATTICE.shape).astype(np.float32)
    made.motion = Motion.constant(np.zeros(3), V)
    return made


@pytest.mark.parametrize("known", [False, True])
def test_a_coupled_step_solves_for_the_constraint_and_the_known_depths(fit, monkeypatch, known):
    fit.front = 1.0
    if known:
        fit.structure = Structure(np.full(NODES, 0.04), np.linspace(0, 40, NODES))
    epipolar, config, motion = fit.epipolar, fit.config, fit.motion
    expected = NormalEquations(LATTICE, MOTION_UNKNOWNS)
    at = epipolar.kernel_arguments(fit.node_flow, motion)
    add_constraint(
        *at, epipolar.usable, config.dec_inlier_px, config.dec_weight, 1.0, *expected.parts
    )
    if known:
        add_structure(
            *at, epipolar.usable, motion.at(0.5)[1], motion.speed,
            np.full(NODES, 0.04), np.linspace(0, 40, NODES),
            0.3 * INFORMATION_EXCESS / LATTICE.times, *expected.parts,
        )  # fmt: skip
    seen = []

    def solve(self, *_):
        seen.extend(part.copy() for part in self.parts)
        return np.zeros(LATTICE.unknowns), np.zeros(MOTION_UNKNOWNS)

    monkeypatch.setattr(NormalEquations, "solve_bordered", solve)
    fit.step_coupled(None)
    for one, other in zip(seen[:3], expected.parts[:3], strict=True):
        np.testing.assert_array_equal(one, other)
    # The motion's change is stiff, and v keeps its length; the motion does not change yet.
    of_v = np.trace(expected.corner[np.ix_(OF_V, OF_V)]) / 24
    change, along = np.hstack([-np.eye(6), np.eye(6), np.zeros((6, 1))]), np.zeros(13)
    stiffness = 0.3 * np.repeat([epipolar.px_per_rad**2, of_v], 3)
    along[OF_V] = np.tile(V, 2) / 2
    corner = expected.corner + change.T * stiffness @ change + of_v * np.outer(along, along)
    corner += np.diag(1e-6 * np.diag(corner) + 1e-9)
    np.testing.assert_allclose(seen[3], corner, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(seen[4], expected.corner_vector, atol=1e-6)


@pytest.mark.parametrize(("begin_ms", "length_ms"), [(0, 100), (25, 100), (70, 30), (-200, 300)])
def test_a_window_starts_from_the_motion_at_the_end_of_the_last_one(fit, begin_ms, length_ms):
    w, more = np.array([0.3, -0.1, 0.2]), np.radians([5.0, -2.0, 1.0])
    ends = 0.1 * np.stack([w - more, w + more])  # of 0.1 s
    still = np.zeros(LATTICE.shape, np.float32)
    scene = Structure(np.ones(len(LATTICE.pixels)), np.ones(len(LATTICE.pixels)))
    last = Memory(
        0, 100 * NS_PER_MS, still, Motion(ends, np.stack([V, V])), scene, MotionModel.FULL
    )
    begin = begin_ms * NS_PER_MS
    last.predict(fit, Window(begin, begin + length_ms * NS_PER_MS, Events.empty()))
    for s in (0.0, 1.0):
        found, direction = fit.motion.at(s)
        np.testing.assert_allclose(found, length_ms / 1000 * (w + more), rtol=1e-9)
        np.testing.assert_allclose(direction, V)
    assert fit.motion.speed == pytest.approx(length_ms / 100)
