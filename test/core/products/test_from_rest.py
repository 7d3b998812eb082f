"""What is told before anything was measured: rest, the dark and slow edges."""

import numpy as np
import pytest
from scene_streams import (
    FOCAL_PX,
    continuous,
    darkness,
    go_on,
    measured,
    nothing,
    scene,
    widest,
    window,
)

from emoflow_ros.core.products.continuous import ContinuousEstimator, State
from emoflow_ros.core.products.wide import why_wide
from emoflow_ros.core.types.estimate import Status


@pytest.fixture
def stream() -> ContinuousEstimator:
    return continuous()


@pytest.mark.parametrize("status", [Status.NO_MOTION, Status.TOO_FEW_EVENTS, Status.DIVERGED])
@pytest.mark.parametrize("noise_hz", [0.05, 0.5, 5.0])
def test_noise_from_the_start_may_be_rest_or_the_dark(stream, status, noise_hz):
    told = go_on(stream, State(), scene(0.0, 2.0, noise_hz), 140, 1900, status)
    widest(told)
    assert {why_wide(e) for e in told} == {str(status)}


def test_a_camera_that_rests_from_the_start_is_still_after_its_first_motion(stream):
    events = scene(lambda t: 100.0 if 0.4 < t < 0.8 else 0.0, 1.5)
    state = State()
    for end, status in ((200, "bounded"), (380, "bounded"), (600, "ok"), (780, "ok")):
        at = window(events, end)
        found = measured(at, 100.0) if status == "ok" else nothing(at)
        state, told = stream.step(state, at, found)
        assert str(told.status) == status
    told = go_on(stream, state, events, 940, 1500)
    assert {e.status for e in told} == {Status.STILL}
    sigma = np.degrees([np.sqrt(np.diag(e.covariance)[3:]) for e in told])
    assert sigma.max() < 1.0


def test_the_light_that_goes_out_before_anything_was_measured_is_no_rest(stream):
    events = darkness(0.0)
    widest(go_on(stream, State(), events, 140, 1900))


@pytest.mark.parametrize("status", [Status.NO_MOTION, Status.TOO_FEW_EVENTS])
def test_a_sensor_that_sends_hardly_an_event_tells_nothing(stream, status):
    told = go_on(stream, State(), scene(0.0, 1.0, 0.001), 140, 900, status)
    assert {e.status for e in told} == {status}
    assert not any(e.told for e in told)


def test_after_edges_that_bounded_the_motion_noise_alone_allows_any(stream):
    """The scene may have left the image, or the light may have gone out."""
    events = scene(lambda t: 15.0 if t < 0.4 else 0.0, 2.0)
    told = go_on(stream, State(), events, 200, 1900)
    sigma = np.degrees([np.sqrt(e.covariance[4, 4]) for e in told])
    assert {e.status for e in told} == {Status.BOUNDED}
    assert sigma[0] < 15.0
    np.testing.assert_allclose(sigma[10:], 60.0)


def test_edges_that_move_before_anything_was_measured_bound_the_motion(stream):
    told = go_on(stream, State(), scene(15.0, 1.0), 200, 400)
    assert {e.status for e in told} == {Status.BOUNDED}
    w = 15.0 / FOCAL_PX
    assert all(w < np.sqrt(e.covariance[4, 4]) for e in told)
