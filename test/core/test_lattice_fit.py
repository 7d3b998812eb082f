import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import load_config
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
