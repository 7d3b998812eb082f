"""What is told of windows in which nothing is measured: rest, darkness, and motion that goes on."""

from dataclasses import replace

import numpy as np
import pytest
from scene_streams import (
    FOCAL_PX,
    MOVES_UNTIL_S,
    after_motion,
    continuous,
    darkness,
    go_on,
    measured,
    nothing,
    scene,
    stops,
    widest,
    window,
)

from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.products.continuous import ContinuousEstimator, State
from emoflow_ros.core.products.settings import STREAM
from emoflow_ros.core.types.estimate import REMEMBERED, MotionModel, Status
from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.core.types.gyro import GyroState, GyroStatus

DRIFT = np.radians(LatticeConfig().angular_drift)


@pytest.fixture
def stream() -> ContinuousEstimator:
    return continuous()


@pytest.mark.parametrize("noise_hz", [0.05, 0.5])
@pytest.mark.parametrize("status", [Status.NO_MOTION, Status.TOO_FEW_EVENTS])
def test_a_camera_that_stops_is_still_for_as_long_as_it_rests(stream, noise_hz, status):
    events = stops(noise_hz)
    told = go_on(stream, after_motion(stream, events), events, 540, 2000, status)
    assert [e.status for e in told] == [Status.STILL] * len(told)
    for found in told:
        np.testing.assert_array_equal([found.angular, found.linear], 0)
        sigma = np.degrees(np.sqrt(np.diag(found.covariance)))
        assert (sigma[3:] < 1.0).all() and (np.sqrt(np.diag(found.covariance)[:3]) < 0.05).all()
        assert found.model is MotionModel.STATIC and not found.translation_observable
        assert found.quality.stop_reason == str(status)
        assert found.motion is not None
        np.testing.assert_array_equal(found.motion.angular(found.t), 0)


def test_darkness_is_no_rest(stream):
    events = darkness(MOVES_UNTIL_S)
    told = go_on(stream, after_motion(stream, events), events, 472.5, 2000)
    by_time = {round(e.t_end / NS_PER_MS): e.status for e in told}
    assert all(status is Status.CARRIED for t, status in by_time.items() if t < 800)
    assert all(status is Status.LOST for t, status in by_time.items() if t > 950)
    assert {e.quality.stop_reason for e in told} == {"brightness"}
    lost = told[-1]
    assert lost.motion is None and lost.covariance[0, 0] == -1 and not lost.told


def test_what_is_measured_while_the_light_goes_out_is_not_believed(stream):
    events = darkness(MOVES_UNTIL_S)
    state = after_motion(stream, events)
    at = window(events, 472.5)
    _, told = stream.step(state, at, measured(at, 900.0))
    assert told.status is Status.CARRIED and told.flow is None
    assert np.linalg.norm(told.angular) < 1.01 * 100.0 / FOCAL_PX


def test_a_gyro_tells_w_while_the_light_goes_out(stream):
    events = darkness(MOVES_UNTIL_S)
    state = after_motion(stream, events)
    at = window(events, 472.5)
    translates = replace(
        measured(at, 900.0), gyro=GyroStatus(GyroState.USED), model=MotionModel.FULL,
        linear=np.array([0.0, 0.0, 1.0]), covariance=1e-4 * np.eye(6),
    )  # fmt: skip
    state, told = stream.step(state, at, translates)
    assert (told.status, told.by_events) == (Status.OK, Status.NO_MOTION)
    np.testing.assert_array_equal(told.angular, translates.angular)
    assert told.flow is None and not told.translation_observable and told.covariance[0, 0] == -1
    assert state.gauge is None


def test_a_sensor_of_one_polarity_is_not_always_in_the_dark(stream):
    events = stops()
    events = replace(events, p=np.ones(len(events), bool))
    told = go_on(stream, after_motion(stream, events), events, 540, 1000)
    assert {e.status for e in told} == {Status.STILL}


def test_after_the_dark_a_measured_motion_makes_the_scene_known_again(stream):
    events = darkness(MOVES_UNTIL_S)
    state = after_motion(stream, events)
    for end in (472.5, 540.0):
        at = window(events, end)
        state, _ = stream.step(state, at, nothing(at))
    assert state.dark and state.gauge is None
    at = window(scene(100.0, 1.0), 607.5)
    state, told = stream.step(state, at, measured(at, 100.0))
    assert told.status is Status.OK and not state.dark and state.gauge is not None


def test_a_motion_that_is_not_measured_is_carried_on_as_a_random_walk(stream):
    """No events tell more: few come."""
    state = after_motion(stream, stops())
    empty = scene(0.0, 2.0, 0.001)
    told = go_on(stream, state, empty, 472.5, 1400, Status.TOO_FEW_EVENTS)
    assert state.motion is not None and state.measured is not None
    for found in told:
        since = (found.t - state.measured) * 1e-9
        if since > 0.5:
            assert found.status is Status.LOST
            continue
        assert found.status is Status.CARRIED
        np.testing.assert_allclose(found.angular, state.motion.angular)
        expected = np.diag(state.motion.covariance)[3:] + DRIFT**2 * since
        np.testing.assert_allclose(np.diag(found.covariance)[3:], expected, rtol=1e-9)
        assert found.quality.stop_reason == "too_few_events"
    assert [e.status for e in told].count(Status.CARRIED) == 6
    assert told[-1].status is Status.LOST


@pytest.mark.parametrize(
    ("status", "first"),
    [(Status.NO_MOTION, Status.BOUNDED), (Status.TOO_FEW_EVENTS, Status.CARRIED)],
)
def test_a_slow_drift_is_bounded_for_as_long_as_it_lasts(stream, status, first):
    """What was measured before is carried on only where nothing says that it has ended."""
    events = scene(lambda t: 100.0 if t < MOVES_UNTIL_S else 8.0, 3.0)
    told = go_on(stream, after_motion(stream, events), events, 540, 3000, status)
    assert {e.status for e in told} == {first, Status.BOUNDED}
    assert [e.status for e in told[10:]] == [Status.BOUNDED] * len(told[10:])
    true = np.array([0.0, -8.0 / FOCAL_PX, 0.0])
    squares = [
        (e.angular - true) @ np.linalg.solve(e.covariance[3:, 3:], e.angular - true) / 3
        for e in told
    ]
    assert max(squares) < 3 and 0.05 < np.mean(squares) < 2
    sigma = [np.degrees(np.sqrt(e.covariance[4, 4])) for e in told[10:]]
    assert max(sigma) < 6  # the drift is 2 deg/s
    assert all(e.covariance[0, 0] == -1 for e in told[10:])


def test_the_bound_is_narrower_where_nothing_is_seen_to_move(stream):
    events = scene(lambda t: 100.0 if t < MOVES_UNTIL_S else 8.0, 2.0)
    state, at = after_motion(stream, events), window(events, 1500)
    late = replace(state, end=at.t_start)
    (_, blind), (_, seen) = (
        stream.step(late, at, replace(nothing(at), status=status))
        for status in (Status.TOO_FEW_EVENTS, Status.NO_MOTION)
    )
    assert blind.status is seen.status is Status.BOUNDED
    np.testing.assert_array_equal(seen.angular, 0)
    np.testing.assert_allclose(seen.covariance[3:, 3:], STREAM.unseen * blind.covariance[3:, 3:])


def test_a_scene_that_may_have_left_the_image_bounds_the_motion_loosely(stream):
    """And noise alone bounds nothing then: it may be the dark."""
    events = scene(lambda t: 100.0 if t < MOVES_UNTIL_S else 60.0 if t < 2.5 else 0.0, 4.0)
    state = after_motion(stream, events)
    told = go_on(stream, state, events, 540, 3500, Status.TOO_FEW_EVENTS)
    statuses = [str(e.status) for e in told]
    assert list(dict.fromkeys(statuses)) == ["carried", "bounded", "lost"]
    sigma = [np.sqrt(e.covariance[4, 4]) for e in told if e.t_end < 2.5e9]
    assert sigma[10] < 2 * 60.0 / FOCAL_PX < sigma[-1]


def test_a_measured_motion_is_told_however_wide_it_is(stream):
    at = window(scene(0.0, 1.0, 0.001), 200)
    wide = replace(measured(at, 100.0, sigma=50.0), flow=None)
    _, told = stream.step(State(), at, wide)
    assert told.status is Status.OK
    np.testing.assert_array_equal(told.covariance, wide.covariance)


@pytest.mark.parametrize(("degrees", "given"), [(59.0, True), (61.0, False)])
def test_a_direction_is_unknown_from_60_degrees_on(stream, degrees, given):
    at = window(scene(0.0, 1.0, 0.001), 200)
    covariance = np.diag([np.radians(degrees) ** 2, 0.1, 0.0, 1.0, 1.0, 1.0])
    translates = replace(
        measured(at, 100.0), model=MotionModel.FULL, linear=np.array([0.0, 0.0, 1.0]),
        covariance=covariance,
    )  # fmt: skip
    _, told = stream.step(State(), at, translates)
    assert told.status is Status.OK and told.translation_observable is given
    assert told.linear.any() == given and (told.covariance[0, 0] >= 0) == given
    np.testing.assert_array_equal(told.covariance[3:, 3:], np.eye(3))


def test_a_direction_gets_wider_across_itself_until_it_is_unknown(stream):
    at = window(stops(), 400)
    v = np.array([0.0, 0.0, 1.0])
    translates = replace(
        measured(at, 100.0), model=MotionModel.FULL, linear=v,
        covariance=np.diag([0.01, 0.01, 0.0, 1e-4, 1e-4, 1e-4]),
    )  # fmt: skip
    state, _ = stream.step(State(), at, translates)
    told = go_on(stream, state, scene(0.0, 2.0, 0.001), 467.5, 850, Status.TOO_FEW_EVENTS)
    first, last = told[0], told[-1]
    np.testing.assert_array_equal(first.linear, v)
    drift = np.radians(LatticeConfig().direction_drift) ** 2
    expected = 0.01 + drift * (first.t - translates.t) * 1e-9
    np.testing.assert_allclose(np.diag(first.covariance)[:3], [expected, expected, 0.0])
    assert last.status is Status.CARRIED and last.covariance[0, 0] == -1 and not last.linear.any()


def test_after_a_gap_everything_begins_anew(stream):
    events = stops()
    state = after_motion(stream, events)
    at = window(scene(0.0, 3.0), 1600)
    _, told = stream.step(state, at, nothing(at))
    widest([told])


def test_a_step_changes_nothing_but_what_it_returns(stream):
    events = stops()
    state = after_motion(stream, events)
    at = window(events, 540)
    first, second = (stream.step(state, at, nothing(at)) for _ in range(2))
    np.testing.assert_array_equal(first[1].covariance, second[1].covariance)
    assert first[0].t == second[0].t != state.t


def test_a_gyro_at_rest_keeps_its_rate_and_the_events_tell_that_nothing_travels(stream):
    events = stops()
    state = after_motion(stream, events)
    at = window(events, 600)
    alone = replace(
        nothing(at), status=Status.OK, model=MotionModel.ROTATION, gyro=GyroStatus(GyroState.USED),
        angular=np.array([0.02, 0.0, 0.0]), covariance=measured(at, 0.0, sigma=1e-4).covariance,
    )  # fmt: skip
    assert alone.by_events is Status.NO_MOTION
    _, told = stream.step(state, at, alone)
    assert told.status is Status.STILL
    np.testing.assert_allclose(told.angular, [0.02, 0.0, 0.0], rtol=0.01)
    assert 0 < told.covariance[0, 0] < 0.01 and not told.linear.any()
    moving = window(scene(50.0, 1.0), 600)
    _, told = stream.step(state, moving, replace(alone, t_start=moving.t_start))
    assert told.status is Status.OK and told.covariance[0, 0] == -1


@pytest.mark.parametrize(("px_s", "status"), [(0.0, Status.STILL), (50.0, Status.OK)])
def test_what_patches_alone_tell_counts_unless_the_camera_rests(stream, px_s, status):
    state = after_motion(stream, stops())
    at = window(scene(px_s, 1.0), 600)
    found = measured(at, 20.0)
    alone = replace(found, quality=replace(found.quality, stop_reason=REMEMBERED))
    after, told = stream.step(state, at, alone)
    assert told.status is status
    if status is Status.STILL:
        assert not told.angular.any() and told.flow is None
        return
    np.testing.assert_allclose(told.angular, alone.angular, rtol=0.01)
    wide = replace(alone, covariance=measured(at, 20.0, sigma=2.0).covariance)
    _, held = stream.step(state, at, wide)
    assert held.motion is not None
    np.testing.assert_array_equal(held.motion.angular(held.t), held.angular)
    assert np.linalg.norm(held.angular) < 0.1 * np.linalg.norm(told.angular)
    assert told.flow is alone.flow and told.bound is state.gauge is after.gauge
    assert after.measured == told.t
