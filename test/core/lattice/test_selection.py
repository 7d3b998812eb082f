from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.fit import FreeFlow
from emoflow_ros.core.lattice.selection import rotates

LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
CERTAIN = np.tile(100 * np.eye(2), (NODES, 1, 1))  # to 0.1 px
CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7, "plumb_bob", (-0.34, 0.14, 0.0, 0.0))
EPIPOLAR = NodeEpipolar(CAMERA, LATTICE, 0.7)
V = np.array([0.6, 0.0, 0.8])
W = np.array([0.01, -0.02, 0.03])
DEPTH = np.exp(np.random.default_rng(1).uniform(np.log(20), np.log(80), NODES))  # windows


def field(v, w, noise_px=0.1, seed=2) -> FreeFlow:
    exact = (EPIPOLAR.a @ v) / DEPTH[:, None] + EPIPOLAR.b @ w
    noise = np.random.default_rng(seed).normal(scale=noise_px, size=exact.shape)
    return FreeFlow(exact + noise, CERTAIN)


def judged(free: FreeFlow, v=V) -> bool:
    rotation, full = EPIPOLAR.rotation(*free.evidence), EPIPOLAR.score(v, *free.evidence)
    return rotates(EPIPOLAR, free, rotation, full)


def test_rotations_are_rotations():
    """All that move half of the image by 3 px and more, in noise of 0.1 px."""
    rng = np.random.default_rng(3)
    for seed in range(100):
        w, v = rng.normal(size=(2, 3))
        w *= rng.uniform(3, 20) / np.median(np.linalg.norm(EPIPOLAR.b @ w, axis=1))
        assert judged(field(np.zeros(3), w, seed=seed), v / np.linalg.norm(v))


def test_translations_are_not():
    rng = np.random.default_rng(4)
    for seed in range(100):
        w, v = rng.normal(scale=0.02, size=3), rng.normal(size=3)
        v /= np.linalg.norm(v)
        assert not judged(field(v, w, seed=seed), v)


@pytest.mark.parametrize(
    ("flow_px", "left_px", "rotation"),
    [(5, 0.05, True), (5, 0.5, False), (30, 0.3, True), (30, 0.8, False)],
)
def test_what_a_rotation_leaves_at_half_of_the_nodes_counts(flow_px, left_px, rotation):
    """To either side at 60 % of the nodes: a share of the flow, and 0.6 px at most."""
    exact = EPIPOLAR.b @ W
    exact *= flow_px / np.median(np.linalg.norm(exact, axis=1))
    left = np.random.default_rng(5).choice([-left_px, left_px], size=exact.shape)
    left[np.random.default_rng(6).random(NODES) > 0.6] = 0.0
    assert judged(FreeFlow(exact + left, CERTAIN)) is rotation


@pytest.mark.parametrize(("share", "rotation"), [(0.9, True), (1.1, False)])
def test_a_motion_that_costs_far_less_is_no_rotation(share, rotation):
    """Though the rotation leaves little of the flow."""
    free = field(np.zeros(3), W)
    alone = EPIPOLAR.rotation(*free.evidence)
    full = replace(alone, residual=alone.residual / (4.5 * share))
    assert rotates(EPIPOLAR, free, alone, full) is rotation


def test_errors_along_an_edge_do_not_count():
    """Nodes that see edges of one direction only know nothing of the flow along them."""
    angle = np.random.default_rng(7).uniform(0, np.pi, NODES)
    normal = np.stack([np.cos(angle), np.sin(angle)], -1)
    along = np.stack([-normal[:, 1], normal[:, 0]], -1)
    information = 100 * normal[:, :, None] * normal[:, None, :] + 1e-6 * np.eye(2)
    hidden = np.random.default_rng(8).normal(scale=4, size=(NODES, 1)) * along
    assert judged(FreeFlow(EPIPOLAR.b @ W + hidden, information))


def test_nodes_without_events_do_not_count():
    exact = EPIPOLAR.b @ W
    lost = np.arange(NODES) % 3 > 0
    information = CERTAIN * np.where(lost, 0.0, 1.0)[:, None, None]
    assert judged(FreeFlow(exact + np.where(lost, 20.0, 0.0)[:, None], information))


def test_without_evidence_nothing_is_told():
    assert not judged(FreeFlow(np.zeros((NODES, 2)), np.zeros((NODES, 2, 2))))


def test_a_fit_goes_on_with_the_model_that_the_flow_shows():
    """From a guess of v that the rotation has left: to the translation that is, and back."""
    estimator = LatticeEstimator(CAMERA, load_config("realtime").estimator)
    fit, guess = estimator._fit, np.array([0.0, 1.0, 0.0])
    fit.motion = Motion.constant(W, guess)
    turning, travelling = field(np.zeros(3), W), field(V, 0.5 * W)
    assert estimator._reconsider(turning)
    np.testing.assert_allclose(fit.node_flow[:, 0], EPIPOLAR.b @ W, atol=0.1)
    assert not estimator._reconsider(turning)  # as it was
    assert estimator._reconsider(travelling)
    w, v = fit.motion.at(0.5)
    np.testing.assert_allclose(w, 0.5 * W, atol=0.004)
    assert abs(v @ V) > np.cos(np.radians(16))  # the grid's
    assert estimator._agreement * (v @ V) > 0.8
    assert estimator._reconsider(turning)
    np.testing.assert_allclose(fit.node_flow[:, 0], EPIPOLAR.b @ W, atol=0.1)
