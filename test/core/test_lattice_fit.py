import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import load_config
from emoflow_ros.core.contrast import WindowEvents
from emoflow_ros.core.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_fit import LatticeFit

CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7)
LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
V = np.array([0.8, 0.0, 0.6])


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


@pytest.mark.parametrize("sign", [1, -1])
def test_flow_from_behind_the_camera_is_drawn_to_none(fit, sign):
    """Whichever sign v has in the fit: `front` says along which one the camera moves."""
    fit.front = sign
    residuals, weight = fit._front_term(Motion.constant(np.zeros(3), sign * V))
    length = np.linalg.norm(fit.node_flow, axis=-1)
    turned = np.arange(NODES) % 10 == 0
    assert not weight[~turned].any()
    np.testing.assert_allclose(np.abs(residuals.r), length, rtol=1e-3)
    inlier = fit.config.dec_inlier_px
    expected = fit.config.dec_weight / (1 + (length[turned] / inlier) ** 2) ** 2
    np.testing.assert_allclose(weight[turned], expected, rtol=1e-3)


def test_without_a_known_side_nothing_is_behind(fit):
    assert not fit._front_term(fit.motion)[1].any()


@pytest.mark.parametrize("late_px", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("turned", [False, True])
def test_what_the_last_or_the_first_third_moves_off_the_fit(fit, late_px, turned):
    """Dots move by 12 px in the window, and by more in a third at its end than the fit knows."""
    rng = np.random.default_rng(0)
    s = np.sort(rng.random(12_000)).astype(np.float32)
    dots = rng.uniform([40, 40], [300, 220], (100, 2))[rng.integers(0, 100, len(s))]
    way = 12.0 * s + 3 * late_px * np.maximum(s - 2 / 3, 0)
    xy = (dots + np.outer(way, [0.6, 0.8])).astype(np.float32)
    if turned:  # in time: the third at its beginning
        s, xy = 1 - s[::-1], xy[::-1]
    x, y = np.ascontiguousarray(xy.T)
    events = WindowEvents(x, y, np.ascontiguousarray(s), np.ones_like(s))
    fit.flow[:] = (-1 if turned else 1) * 12.0 * np.array([0.6, 0.8], np.float32)
    assert fit.change_px(events) == pytest.approx(late_px, abs=0.3 + 0.1 * late_px)


def test_a_third_with_few_events_tells_no_change(fit):
    few = [np.full(800, value, np.float32) for value in (100.0, 100.0, 0.5, 1.0)]
    assert fit.change_px(WindowEvents(*few)) == 0.0
