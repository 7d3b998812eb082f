import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.fit import FreeFlow
from emoflow_ros.core.lattice.selection import ModelSelector
from emoflow_ros.core.types.estimate import MotionModel

LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
CERTAIN = np.tile(np.eye(2), (NODES, 1, 1))
EPIPOLAR = NodeEpipolar(
    Camera(346, 260, 226.4, 226.2, 173.6, 133.7, "plumb_bob", (-0.34, 0.14, 0.0, 0.0)),
    LATTICE,
    0.7,
)
V = np.array([0.6, 0.0, 0.8])
W = np.array([0.01, -0.02, 0.03])
DEPTH = np.exp(np.random.default_rng(1).uniform(np.log(20), np.log(80), NODES))  # windows


def field(v, w, noise_px=0.1, seed=2) -> FreeFlow:
    exact = (EPIPOLAR.a @ v) / DEPTH[:, None] + EPIPOLAR.b @ w
    noise = np.random.default_rng(seed).normal(scale=noise_px, size=exact.shape)
    return FreeFlow(exact + noise, CERTAIN)


def rotation(w=W, seed=2) -> FreeFlow:
    return field(np.zeros(3), w, seed=seed)


def test_rotations_are_rotations():
    """All that move half of the image by 2 px and more, in noise of 0.1 px."""
    rng = np.random.default_rng(3)
    for seed in range(100):
        w, v = rng.normal(size=(2, 3))
        w *= rng.uniform(2, 20) / np.median(np.linalg.norm(EPIPOLAR.b @ w, axis=1))
        selector = ModelSelector()
        chosen = selector.update(EPIPOLAR, rotation(w, seed), w, v / np.linalg.norm(v))
        assert chosen is selector.model is MotionModel.ROTATION


def test_translations_are_not():
    rng = np.random.default_rng(4)
    for seed in range(100):
        w, v = rng.normal(scale=0.02, size=3), rng.normal(size=3)
        v /= np.linalg.norm(v)
        selector = ModelSelector()
        assert selector.update(EPIPOLAR, field(v, w, seed=seed), w, v) is MotionModel.FULL
        assert selector.agreement > 0.8


def test_agreement_is_plus_one_before_and_minus_one_behind_the_camera():
    free = field(V, W, noise_px=0.0)
    for sign in (1, -1):
        selector = ModelSelector()
        selector.update(EPIPOLAR, free, W, sign * V)
        assert selector.agreement == pytest.approx(sign)


def test_one_contradiction_does_not_turn_the_direction_but_several_do():
    selector = ModelSelector()
    agreements = []
    for v in (V, V, -V, -V, -V, -V):  # of the scene; the fit keeps saying V
        selector.update(EPIPOLAR, field(v, W), W, V)
        agreements.append(selector.agreement)
    assert agreements[0] > 0.9
    assert 0 < agreements[2] < agreements[0]
    assert agreements[-1] < 0


def test_residual_of_a_rotation_is_what_it_leaves_at_half_of_the_nodes():
    """0.5 px to either side at 60 % of the nodes, which no rotation explains."""
    free = rotation()
    exact = EPIPOLAR.b @ W
    left = np.random.default_rng(5).choice([-0.5, 0.5], size=exact.shape)
    left[np.random.default_rng(6).random(NODES) > 0.6] = 0.0
    selector = ModelSelector()
    selector.update(EPIPOLAR, FreeFlow(exact + left, free.information), W, V)
    assert selector.residual_px == pytest.approx(0.5 * np.sqrt(2), rel=0.1)
    median = np.median(np.linalg.norm(exact, axis=1))
    assert selector.residual_share == pytest.approx(selector.residual_px / median, rel=0.1)


def test_errors_along_an_edge_do_not_count():
    """Nodes that see edges of one direction only know nothing of the flow along them."""
    angle = np.random.default_rng(7).uniform(0, np.pi, NODES)
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    along = np.stack([-normal[:, 1], normal[:, 0]], -1)
    information = normal[:, :, None] * normal[:, None, :] + 1e-6 * np.eye(2)
    hidden = np.random.default_rng(8).normal(scale=4, size=(NODES, 1)) * along
    selector = ModelSelector()
    free = FreeFlow(EPIPOLAR.b @ W + hidden, information)
    assert selector.update(EPIPOLAR, free, W, V) is MotionModel.ROTATION
    assert selector.residual_px < 0.1


def test_nodes_without_events_do_not_count():
    exact = EPIPOLAR.b @ W
    lost = np.arange(NODES) % 3 > 0
    information = CERTAIN * np.where(lost, 0.0, 1.0)[:, None, None]
    flow = exact + np.where(lost, 20.0, 0.0)[:, None]
    selector = ModelSelector()
    assert selector.update(EPIPOLAR, FreeFlow(flow, information), W, V) is MotionModel.ROTATION


def test_the_model_follows_a_change_of_motion():
    selector = ModelSelector()
    for seed in range(5):
        selector.update(EPIPOLAR, rotation(seed=seed), W, V)
    assert selector.model is MotionModel.ROTATION
    models = [selector.update(EPIPOLAR, field(V, W, seed=seed), W, V) for seed in range(4)]
    assert models[-1] is MotionModel.FULL
    models = [selector.update(EPIPOLAR, rotation(seed=seed), W, V) for seed in range(12)]
    assert models[-1] is MotionModel.ROTATION
    assert selector.windows == 21


def test_without_evidence_nothing_fails():
    nothing = FreeFlow(np.zeros((NODES, 2)), np.zeros((NODES, 2, 2)))
    selector = ModelSelector()
    selector.update(EPIPOLAR, nothing, np.zeros(3), V)
    assert selector.agreement == 0.0
    figures = (selector.residual_px, selector.residual_share, selector.advantage)
    assert np.isfinite(figures).all()
