"""How fast a known scene moves at most, against scenes whose speed is known."""

from dataclasses import replace

import numpy as np
import pytest
from scene_streams import CAMERA, FOCAL_PX, measured, scene, window

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.gauge import Gauge, covered, scatter, structured
from emoflow_ros.core.products.settings import STREAM
from emoflow_ros.core.types.events import Events


def gauged(noise_hz: float = 0.2) -> Gauge:
    at = window(scene(100.0, 0.2, noise_hz), 180)
    found = Gauge.measured(CAMERA, at, measured(at, 100.0))
    assert found is not None
    return found


@pytest.mark.parametrize("px_s", [10.0, 20.0, 40.0])
@pytest.mark.parametrize("noise_hz", [0.05, 1.0])
def test_the_speed_of_a_scene_that_was_seen_is_bounded_closely(px_s, noise_hz):
    speed = gauged(noise_hz).speed(window(scene(px_s, 0.3, noise_hz), 300))
    assert speed is not None
    assert 0.7 * px_s < speed < 2.0 * px_s


@pytest.mark.parametrize("noise_hz", [0.05, 1.0, 3.0])
def test_noise_alone_does_not_move(noise_hz):
    speed = gauged(noise_hz).speed(window(scene(0.0, 0.3, noise_hz), 300))
    assert speed is not None and speed < 2.0


def test_few_events_tell_nothing():
    few = window(scene(0.0, 0.3, 0.001), 300)
    assert 0 < len(few.events) < 20
    assert gauged().speed(few) is None


@pytest.mark.parametrize("before_end", [0, 1])
def test_events_that_all_come_at_the_end_count_over_the_whole_window(before_end):
    whole = window(scene(200.0, 0.3), 300)
    events = replace(whole.events, t=np.full(len(whole.events), whole.t_end - before_end))
    speed = gauged().speed(replace(whole, events=events))
    way = scatter(events, CAMERA, surely=False) / gauged().per_px
    assert way > STREAM.longest_px and speed is not None and speed >= way / whole.duration


def test_an_image_that_hardly_moves_gauges_nothing():
    at = window(scene(1.0, 0.3), 300)
    assert Gauge.measured(CAMERA, at, measured(at, 1.0)) is None


def test_thinned_events_count_as_what_they_stand_for():
    events = window(scene(100.0, 0.2), 180).events
    few = events[::3]
    few = replace(few, stands_for=np.full(len(few), 3, np.uint32))
    whole = scatter(events, CAMERA, surely=False)
    assert scatter(few, CAMERA, surely=False) == pytest.approx(whole, rel=0.1)


def test_rotations_that_move_the_image_at_this_speed_are_a_standard_deviation():
    sigma = np.sqrt(np.diag(gauged().rotation_covariance(20.0)))
    np.testing.assert_allclose(sigma[:2], 20.0 / FOCAL_PX)
    assert sigma[2] == pytest.approx(20.0 / 115.1, rel=1e-3)  # mean distance from the centre


def test_a_larger_sensor_is_gauged_in_the_working_image():
    camera = Camera(1383, 1040, 904.0, 904.0, 692.0, 520.0)  # 345 * 4 + 3 wide
    sigma = np.sqrt(np.diag(Gauge(camera, 1.0).rotation_covariance(20.0)))
    np.testing.assert_allclose(sigma[:2], 20.0 / FOCAL_PX, rtol=0.01)


def test_light_that_changes_covers_the_image_and_a_moving_scene_does_not():
    moving = window(scene(100.0, 0.2), 180).events
    assert covered(moving, CAMERA) < 0.7
    rng = np.random.default_rng(0)
    y, x = (rng.integers(0, n, 90_000).astype(np.uint16) for n in (260, 346))
    flash = Events(x, y, np.arange(90_000), np.zeros(90_000, bool))
    assert covered(flash, CAMERA) > 0.95


def test_edges_are_told_from_noise_and_from_noise_in_pairs():
    noise = window(scene(0.0, 0.2, 0.5), 180).events
    pairs = Events.concatenate([noise, noise])
    assert not structured(noise, CAMERA) and not structured(pairs, CAMERA)
    diagonal = noise[:900]
    assert not structured(replace(diagonal, y=diagonal.x % 260), CAMERA)
    assert structured(window(scene(15.0, 0.2, 0.5), 180).events, CAMERA)
