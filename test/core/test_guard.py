"""What moves in one spot only may be an object before a camera at rest."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import WindowSlicer
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.simulation.sensor import SensorModel


def estimates(
    scene: str, seed: int, noise_hz: float | None = None, *, whole: bool = False, **options
) -> list[Estimate]:
    """Of half a second, in windows by motion or in whole ones."""
    sensor = SensorModel() if noise_hz is None else SensorModel(noise_hz=noise_hz)
    recording = simulate(scene, duration_s=0.5, seed=seed, fps=200, sensor=sensor)
    config = load_config("realtime")
    config = replace(config, estimator=replace(config.estimator, **options))
    if whole:
        config = replace(config, window=replace(config.window, max_displacement_px=0.0))
    estimator = make_estimator(recording.camera, config)
    windows = WindowSlicer(config.window).push(recording.events)
    assert len(windows) >= 5
    return [estimator.estimate(window) for window in windows]


def shows_no_motion(estimate: Estimate) -> bool:
    """Whether nothing is measured; what moves bounds the camera's motion at most."""
    bounded = estimate.status in (Status.NO_MOTION, Status.BOUNDED)
    return bounded and estimate.quality.stop_reason == str(Status.NO_MOTION)


@pytest.mark.parametrize("seed", [0, 1])
def test_object_before_a_camera_at_rest_gives_no_confident_motion(seed):
    for estimate in estimates("bystander", seed, whole=True):
        assert shows_no_motion(estimate)
        assert estimate.model is MotionModel.STATIC
        assert estimate.quality.contrast_gain > 1.2  # something does move
        np.testing.assert_array_equal(estimate.angular, 0)


def test_an_object_before_a_camera_at_rest_gives_no_motion_in_short_parts_either():
    assert all(shows_no_motion(estimate) for estimate in estimates("bystander", 0))


def test_noise_all_over_the_image_does_not_hide_the_camera_s_rest():
    found = estimates("bystander", 0, noise_hz=6.0)
    assert all(shows_no_motion(estimate) for estimate in found)


def test_an_object_before_a_moving_camera_does_not_stop_the_estimate():
    assert all(estimate.status is Status.OK for estimate in estimates("mover", 0))


def test_a_fixed_model_says_that_the_camera_moves():
    assert all(e.status is Status.OK for e in estimates("bystander", 0, model="full"))
