"""A measured angular velocity is held against how fast the events allow the image to move."""

from dataclasses import replace

import numpy as np
import pytest
from scene_streams import (
    CAMERA,
    FOCAL_PX,
    MOVES_UNTIL_S,
    after_motion,
    continuous,
    measured,
    scene,
    stops,
    window,
)

from emoflow_ros.core.products.continuous import ContinuousEstimator, State
from emoflow_ros.core.products.gauge import Gauge
from emoflow_ros.core.types.estimate import MotionModel
from emoflow_ros.core.types.gyro import GyroState, GyroStatus


@pytest.fixture
def stream() -> ContinuousEstimator:
    return continuous()


def test_a_wide_motion_is_held_against_what_the_events_allow(stream):
    """Its w alone: the direction stays, with its covariance."""
    events = stops()
    state, at = after_motion(stream, events), window(events, 400)
    true = 100.0 / FOCAL_PX
    covariance = np.diag([0.01, 0.01, 0.0, 4.0, 4.0, 4.0])
    wide = replace(
        measured(at, 400.0), model=MotionModel.FULL, linear=np.array([0.0, 0.0, 1.0]),
        covariance=covariance,
    )  # fmt: skip
    assert state.gauge is not None
    speed = state.gauge.speed(at)
    assert speed is not None and 80 < speed < 160
    before = state.gauge.speed(at.until(wide.t))
    assert before is not None
    speed = max(speed, before)
    of_rest = state.gauge.rotation_covariance(speed)
    _, told = stream.step(state, at, wide)
    expected = of_rest @ np.linalg.inv(of_rest + 4 * np.eye(3)) @ wide.angular
    np.testing.assert_allclose(told.angular, expected)
    assert np.linalg.norm(told.angular) < true < np.linalg.norm(wide.angular)
    np.testing.assert_allclose(told.covariance[3:, 3:], np.linalg.inv(
        np.linalg.inv(of_rest) + np.eye(3) / 4
    ))  # fmt: skip
    np.testing.assert_array_equal(told.covariance[:3], covariance[:3])
    assert told.motion is not None
    np.testing.assert_allclose(told.motion.angular(told.t), expected)
    np.testing.assert_array_equal(told.linear, wide.linear)
    correlated = covariance.copy()
    correlated[0, 4] = correlated[4, 0] = 0.15
    _, both = stream.step(state, at, replace(wide, covariance=correlated))
    share = of_rest[1, 1] / (of_rest[1, 1] + 4)
    np.testing.assert_allclose(both.covariance[0], [0.01, 0, 0, 0, 0.15 * share, 0], atol=1e-12)


def test_a_narrow_motion_and_that_of_a_gyro_stay(stream):
    events = stops()
    state, at = after_motion(stream, events), window(events, 400)
    wide = measured(at, 400.0, sigma=2.0)
    narrow = measured(at, 400.0, sigma=2e-4)
    np.testing.assert_allclose(stream.step(state, at, narrow)[1].angular, wide.angular, rtol=1e-6)
    by_gyro = replace(wide, gyro=GyroStatus(GyroState.USED))
    np.testing.assert_array_equal(stream.step(state, at, by_gyro)[1].angular, wide.angular)


def test_a_first_motion_is_held_within_what_cameras_of_such_a_scene_do(stream):
    at = window(scene(100.0, 1.0), 200)
    supposed = Gauge.supposed(CAMERA)
    speeds = [supposed.speed(part) for part in (at, at.until(measured(at, 0.0).t))]
    of_rest = supposed.rotation_covariance(max(s for s in speeds if s is not None))
    wide = measured(at, 900.0, sigma=5.0)
    _, told = stream.step(State(), at, wide)
    np.testing.assert_allclose(
        told.angular, of_rest @ np.linalg.inv(of_rest + 25 * np.eye(3)) @ wide.angular
    )
    assert np.linalg.norm(told.angular) < 0.6 * np.linalg.norm(wide.angular)


def test_a_motion_is_not_held_against_a_stop_after_the_middle_of_its_window(stream):
    events = stops()
    state, at = after_motion(stream, events), window(events, 450)
    found = measured(at, 100.0, sigma=np.radians(2))
    assert found.t < MOVES_UNTIL_S * 1e9 < at.t_end
    _, told = stream.step(state, at, found)
    np.testing.assert_allclose(told.angular, found.angular, rtol=0.1)
    still = window(events, 600)
    assert state.gauge is not None
    _, told = stream.step(replace(state, end=at.t_end), still, measured(still, 100.0, sigma=0.04))
    assert np.linalg.norm(told.angular) < 0.1 * np.linalg.norm(found.angular)
