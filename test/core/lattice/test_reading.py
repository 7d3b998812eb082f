"""What is read off a fit: motion and model, and how sure it is of v."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.fit import FreeFlow, LatticeFit
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.reading import EstimateReader
from emoflow_ros.core.lattice.uncertainty import PossibleMotions
from emoflow_ros.core.types.estimate import MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window
from emoflow_ros.core.types.gyro import GyroStatus

CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7)
V = np.array([0.8, 0.0, 0.6])
ACROSS = np.array([0.0, 1.0, 0.0])
WINDOW = Window(0, 90 * NS_PER_MS, Events.empty())
VARIANCE = 0.01  # of the possible motions' v across V, rad^2


@pytest.fixture
def reader() -> EstimateReader:
    """Of a camera that passes along V, whose possible motions differ in v alone."""
    config = load_config("realtime").estimator
    image = WorkingImage.of(CAMERA)
    lattice = Lattice.with_spacing(*image.camera.size, config.spacing_px)
    epipolar = NodeEpipolar(image.camera, lattice, config.dec_inlier_px)
    fit = LatticeFit(lattice, epipolar, config)
    flow = 0.05 * (epipolar.a @ V)
    fit.flow = np.repeat(flow[:, None], lattice.times, 1).reshape(lattice.shape).astype(np.float32)
    fit.motion = Motion.constant(np.zeros(3), V)
    fit.evidence[:] = np.eye(2)
    return EstimateReader(image, epipolar, fit, config)


def read(
    reader: EstimateReader, known=None, agreement=1.0, v=0.0, mean=None, model="full", spread=None
):
    """The estimate of possible motions with a variance of v, or another spread."""
    free = FreeFlow(np.zeros((0, 2)), np.zeros((0, 2, 2)), known)
    if spread is None:
        spread = np.diag([0.0, 0.0, 0.0, *v * ACROSS])
    possible = PossibleMotions(np.zeros(6) if mean is None else mean, spread)
    quality = Quality(3000, 5, "converged", 2.0)
    return reader.read(WINDOW, free, MotionModel(model), possible, agreement, quality, GyroStatus())


def spread_counts(reader: EstimateReader, known) -> float:
    """Variance of v across V that a spread adds, over that of the spread."""
    alone, with_spread = (
        float(ACROSS @ read(reader, known, v=v).covariance[:3, :3] @ ACROSS)
        for v in (0.0, VARIANCE)
    )
    return (with_spread - alone) / VARIANCE


def test_the_spread_of_v_counts_more_with_a_gyro(reader):
    """Also with one that tells nothing: how the motions were weighed is what matters."""
    by_events, with_gyro = (
        spread_counts(reader, known) for known in (None, (np.zeros(3), np.zeros((3, 3))))
    )
    assert 0.5 < by_events < with_gyro


@pytest.mark.parametrize("agreement", [0.9, -0.9])
def test_the_scene_lies_in_front_of_the_camera(reader, agreement):
    """Where it agrees with -V, the camera moves along -V: in the twist, and over the window."""
    found = read(reader, agreement=agreement)
    assert (found.status, found.model) == (Status.OK, MotionModel.FULL)
    np.testing.assert_allclose(found.linear, np.sign(agreement) * V)
    direction = found.motion.linear(found.t)
    np.testing.assert_allclose(direction / np.linalg.norm(direction), found.linear)
    np.testing.assert_allclose(found.covariance[:3, :3] @ V, 0.0, atol=1e-15)


@pytest.mark.parametrize(("model", "variance"), [("rotation", 0.0), ("full", 1.0)])
def test_a_rotation_or_an_unknown_direction_tells_no_translation(reader, model, variance):
    told, untold = read(reader), read(reader, model=model, v=variance)
    assert (told.model, untold.model) == (MotionModel.FULL, MotionModel.ROTATION)
    assert not untold.linear.any()
    assert untold.covariance[0, 0] == -1.0
    np.testing.assert_allclose(untold.covariance[3:, 3:], told.covariance[3:, 3:])


def test_the_mean_over_the_motions_is_told_and_goes_with_the_spline(reader):
    """w in rad/s, of a window of 0.09 s."""
    mean = np.array([0.009, -0.018, 0.0, 0.0, 0.1, 0.0])
    found = read(reader, mean=mean)
    np.testing.assert_allclose(found.angular, [0.1, -0.2, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.linear, (V + mean[3:]) / np.linalg.norm(V + mean[3:]))
    np.testing.assert_allclose(found.motion.angular(found.t), found.angular, atol=1e-12)
    np.testing.assert_allclose(found.covariance[:3, :3] @ found.linear, 0.0, atol=1e-15)


@pytest.mark.parametrize("model", ["rotation", "full", "translation"])
def test_a_model_that_is_given_is_told(reader, model):
    """Though possible motions do not agree on a direction."""
    reader._config = replace(reader._config, model=model)
    found = read(reader, v=1.0, mean=np.full(6, 0.01), model=model)
    assert found.model == model
    moved = {"full": 0.01 / 0.09}.get(model, 0.0)  # what is possible else does not count
    np.testing.assert_allclose(found.angular, moved, atol=1e-12)


@pytest.mark.parametrize("agreement", [0.9, -0.9])
def test_the_spread_is_told_in_the_order_and_the_units_of_a_twist(reader, agreement):
    """(v, w), rad/s, of a window of 0.09 s; what w and v share turns with v."""
    factor = 0.03 * np.random.default_rng(5).normal(size=(6, 6))
    spread = factor @ factor.T
    added = (
        read(reader, agreement=agreement, spread=spread).covariance
        - read(reader, agreement=agreement).covariance
    )
    across = np.eye(3) - np.outer(V, V)
    np.testing.assert_allclose(added[3:, 3:], spread[:3, :3] / 0.09**2)
    np.testing.assert_allclose(added[:3, :3], across @ spread[3:, 3:] @ across)
    shared = np.sign(agreement) * across @ spread[3:, :3] / 0.09
    np.testing.assert_allclose(added[:3, 3:], shared)
    np.testing.assert_allclose(added[3:, :3], shared.T)


def test_the_rotation_that_a_gyro_learns_from_is_the_model_s(reader):
    """Of a flow by translation: w of a rotation that is given, or of all motions, which is 0."""
    flow = reader._fit.node_flow.mean(axis=1)
    free = FreeFlow(flow, np.tile(100 * np.eye(2), (len(flow), 1, 1)))
    w, covariance = reader.rotation_of_events(free)
    assert np.linalg.norm(w) < 1e-3
    reader._config = replace(reader._config, model="rotation")
    fixed, narrow = reader.rotation_of_events(free)
    expected = reader._epipolar.rotation(*free.seen, sized=False).w[0]
    np.testing.assert_array_equal(fixed, expected)
    assert np.linalg.norm(fixed) > 0.01
    assert np.trace(narrow) < np.trace(covariance)
