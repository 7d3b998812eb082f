"""The real-time estimator on windows in which nothing moves."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import simulate

CAMERA = Camera(346, 260, 226.4, 226.2, 173.6, 133.7)
CONFIG = LatticeConfig()
START = 1_500_000_000_000_000_000


def noise(count: int, seed: int = 0) -> Window:
    rng = np.random.default_rng(seed)
    t = START + np.sort(rng.integers(0, 90 * NS_PER_MS, count))
    x, y = rng.integers(0, (346, 260), (count, 2)).astype(np.uint16).T
    return Window(START, START + 90 * NS_PER_MS, Events(x, y, t, rng.random(count) < 0.5))


def assert_says_nothing(estimate: Estimate) -> None:
    assert estimate.flow is None and estimate.motion is None
    assert estimate.model is MotionModel.STATIC and not estimate.translation_observable
    np.testing.assert_array_equal(estimate.linear, 0)
    np.testing.assert_array_equal(estimate.angular, 0)
    assert estimate.covariance[0, 0] == -1
    assert not estimate.quality.warm


def assert_any_motion(estimate: Estimate, reason: Status) -> None:
    assert (estimate.status, estimate.quality.stop_reason) == (Status.BOUNDED, str(reason))
    assert estimate.flow is None and estimate.covariance[0, 0] == -1
    np.testing.assert_array_equal([estimate.linear, estimate.angular], 0)
    np.testing.assert_allclose(np.degrees(np.sqrt(np.diag(estimate.covariance)[3:])), 60.0)


@pytest.mark.parametrize("count", [2000, 30_000, 150_000])
def test_noise_is_no_motion(count):
    estimate = LatticeEstimator(CAMERA, CONFIG).estimate(noise(count))
    assert estimate.status is Status.NO_MOTION
    assert estimate.quality.stop_reason == "no_motion"
    assert estimate.quality.contrast_gain < CONFIG.min_contrast_gain
    assert_says_nothing(estimate)


@pytest.mark.parametrize("count", [0, 1, CONFIG.min_events - 1])
def test_too_few_events(count):
    estimate = LatticeEstimator(CAMERA, CONFIG).estimate(noise(count))
    assert estimate.status is Status.TOO_FEW_EVENTS
    assert_says_nothing(estimate)


@pytest.mark.parametrize(("count", "reason"), [
    (30_000, Status.NO_MOTION), (CONFIG.min_events - 1, Status.TOO_FEW_EVENTS),
])  # fmt: skip
def test_with_a_gyro_its_rotation_is_known_all_the_same(count, reason):
    w = np.array([0.3, -0.1, 0.5])
    t = START + np.arange(-5, 96) * NS_PER_MS
    window = replace(
        noise(count), gyro=GyroReadings(t, np.tile(w, (len(t), 1)) + 1e-4 * (t % 3)[:, None])
    )
    estimate = LatticeEstimator(CAMERA, CONFIG).estimate(window)
    assert (estimate.status, estimate.by_events) == (Status.OK, reason)
    assert estimate.model is MotionModel.ROTATION and estimate.flow is None
    np.testing.assert_allclose(estimate.angular, w, atol=2e-4)
    # A bias of 1 deg/s that nothing has taught yet.
    spread = np.degrees(np.sqrt(np.diag(estimate.covariance)[3:]))
    assert (spread > 1.0).all() and (spread < 1.2).all()


def test_a_burst_and_a_few_pixels_are_too_little():
    """A flash has no time to move in, flickering pixels have no place to move to."""
    flash = noise(30_000)
    middle = flash.events.t[:1] + 45 * NS_PER_MS + (flash.events.t - START) // 90
    flicker = replace(flash.events, x=flash.events.x % 3 + 100, y=flash.events.y % 3 + 100)
    for events in (replace(flash.events, t=middle), flicker):
        estimate = LatticeEstimator(CAMERA, CONFIG).estimate(replace(flash, events=events))
        assert estimate.status is Status.TOO_FEW_EVENTS
        assert_says_nothing(estimate)


def test_a_camera_at_rest_does_not_move():
    recording = simulate("static", duration_s=0.1, seed=2, fps=100)
    window = Window(0, recording.t_end, recording.events)
    for options in ({}, {"min_events": 100}):
        estimator = LatticeEstimator(recording.camera, replace(CONFIG, **options))
        estimate = estimator.estimate(window)
        assert estimate.status in (Status.TOO_FEW_EVENTS, Status.NO_MOTION)
        assert_says_nothing(estimate)


def test_light_that_blinks_everywhere_at_once_is_no_motion():
    """As many ON as OFF events at every pixel: the image of the events as they came is empty."""
    rng = np.random.default_rng(0)
    x, y = (np.repeat(c, 2) for c in rng.integers(0, (346, 260), (7000, 2)).astype(np.uint16).T)
    t = START + np.sort(rng.integers(0, 90 * NS_PER_MS, len(x)))
    blinks = Events(x, y, t, np.tile([True, False], 7000))
    estimate = make_estimator(CAMERA, load_config()).estimate(
        Window(START, START + 135 * NS_PER_MS, blinks)
    )
    assert_any_motion(estimate, Status.NO_MOTION)


@pytest.mark.parametrize(("count", "reason"), [
    (30_000, Status.NO_MOTION), (CONFIG.min_events - 1, Status.TOO_FEW_EVENTS),
])  # fmt: skip
def test_noise_from_the_start_may_come_from_a_covered_camera(count, reason):
    assert_any_motion(make_estimator(CAMERA, load_config()).estimate(noise(count)), reason)
