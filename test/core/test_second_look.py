"""A second look at windows, on points that move together."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.normal_equations import NotPositiveDefiniteError
from emoflow_ros.core.second_look import QuickLook, SecondLook, distance, fresh_start
from emoflow_ros.core.window_events import WindowEvents

LATTICE = Lattice.with_spacing(160, 120, 26.0)
CONTRASTS = {scale: Contrast(LATTICE, scale) for scale in (0.25, 0.5)}
MOVED = np.array([9.0, -5.0], np.float32)


ACROSS = LATTICE.pixels.reshape(LATTICE.columns, LATTICE.rows, 1, 2)[..., :1]
TRUE = (np.zeros(LATTICE.shape) + MOVED * (1 + 0.3 * (ACROSS - 80) / 80)).astype(np.float32)


def constant(x: float, y: float) -> np.ndarray:
    return np.zeros(LATTICE.shape, np.float32) + np.array([x, y], np.float32)


@pytest.fixture(scope="module")
def events() -> WindowEvents:
    """300 points, 20 events each along a way that grows to the right, noise of half a pixel."""
    rng = np.random.default_rng(3)
    s = rng.uniform(0, 1, 6000).astype(np.float32)
    points = np.repeat(rng.uniform([12, 12], [148, 108], (300, 2)), 20, axis=0)
    way = MOVED * (1 + 0.3 * (points[:, :1] - 80) / 80)
    x, y = (points + (s[:, None] - 0.5) * way + rng.normal(0, 0.5, (6000, 2))).T
    on = np.repeat(rng.random(300) < 0.5, 20)
    order = np.argsort(s)
    return WindowEvents.prepare(*(c[order].astype(np.float32) for c in (x, y, s)), on[order])


@pytest.fixture(scope="module")
def found(events) -> np.ndarray:
    fresh = fresh_start(CONTRASTS[0.25], events, LATTICE.shape)
    return SecondLook(LATTICE, CONTRASTS, LatticeConfig()).flow(events, fresh)


def test_it_finds_the_flow_by_itself(found):
    errors = np.linalg.norm(found - TRUE, axis=-1)[1:-1, 1:-1]
    assert np.median(errors) < 0.7
    assert errors.max() < 2.0


def test_a_wrong_flow_is_far_from_it_and_the_right_one_close(found, events):
    assert distance(LATTICE, TRUE, found, events) < 0.7
    assert distance(LATTICE, -TRUE, found, events) > 15.0


def test_three_quarters_of_the_events_decide():
    """The flows differ by (3, 4) px in the left part of the image, with 20 or 30 of 100 events."""
    moved = np.where(ACROSS < 85, np.array([3.0, 4.0]), 0.0).astype(np.float32)
    moved = np.repeat(moved, LATTICE.times, axis=2)
    for left, expected in ((20, 0.0), (30, 5.0)):
        x = np.where(np.arange(100) < left, 30.0, 140.0).astype(np.float32)
        y = np.full(100, 60.0, np.float32)
        events = WindowEvents(x, y, np.linspace(0, 1, 100).astype(np.float32), np.ones_like(x))
        apart = distance(LATTICE, moved, np.zeros_like(moved), events)
        assert apart == pytest.approx(expected, abs=1e-5)


def test_weights_that_are_not_finite_have_no_flow(events):
    broken = replace(events, weights=events.weights * np.float32(np.nan))
    with pytest.raises(NotPositiveDefiniteError):
        SecondLook(LATTICE, CONTRASTS, LatticeConfig()).flow(broken, constant(0, 0))


def window(size: tuple[int, int], moved: tuple[float, float], per_point: int) -> Window:
    """A window of 0.1 s in which 400 points move alike; each leaves so many events."""
    rng = np.random.default_rng(5)
    width, height = size
    count = 400 * per_point
    s = np.sort(rng.uniform(0, 1, count))
    points = rng.uniform([0.1 * width, 0.1 * height], [0.9 * width, 0.9 * height], (400, 2))
    at = rng.integers(0, 400, count)
    x, y = np.rint(points[at] + (s[:, None] - 0.5) * moved).astype(np.uint16).T
    t = np.round(s * 1e8).astype(np.int64)
    return Window(0, 10**8, Events(x, y, t, rng.random(400)[at] < 0.5))


@pytest.mark.parametrize("scale", [1, 4])
def test_a_quick_look_finds_the_flow_on_the_sensor(scale):
    """About 40 px in the working image, whatever the sensor."""
    size = (320 * scale, 240 * scale)
    camera = Camera(*size, 300.0 * scale, 300.0 * scale, 160.0 * scale, 120.0 * scale)
    moved = (38.0 * scale, -12.0 * scale)
    seen = QuickLook(camera, LatticeConfig()).flow(window(size, moved, 30))
    assert seen is not None
    inside = seen.displacement(0, 10**8)[size[1] // 4 : -size[1] // 4, size[0] // 4 : -size[0] // 4]
    np.testing.assert_allclose(np.median(inside, axis=(0, 1)), moved, atol=0.7 * scale)
    assert (seen.t_start, seen.t_end) == (0, 10**8)


def test_a_quick_look_shows_nothing_where_there_is_no_motion_or_little_to_see():
    look = QuickLook(Camera(320, 240, 300.0, 300.0, 160.0, 120.0), LatticeConfig())
    assert look.flow(window((320, 240), (0.0, 0.0), 30)) is None
    assert look.flow(window((320, 240), (10.0, 0.0), 2)) is None
    few = window((320, 240), (10.0, 0.0), 30)
    x, y = np.random.default_rng(1).integers([320, 240], size=(len(few.events), 2)).T
    noise = replace(few.events, x=x.astype(np.uint16), y=y.astype(np.uint16))
    assert look.flow(replace(few, events=noise)) is None
