import numpy as np

from emoflow_ros.core.stream.cleaning import without_hot_pixels
from emoflow_ros.core.types.events import Events

WIDTH, HEIGHT = 40, 30


def made_of(pixels) -> Events:
    """One event per entry (x, y), 10 us apart."""
    x, y = np.array(pixels).T
    t = 10_000 * np.arange(len(x))
    return Events(x.astype(np.uint16), y.astype(np.uint16), t, t % 20_000 == 0)


def edge() -> list[tuple[int, int]]:
    """A vertical edge that crosses the sensor and fires nine times at each pixel."""
    return [(x, y) for x in range(WIDTH) for y in range(HEIGHT) for _ in range(9)]


def test_a_pixel_that_fires_alone_is_left_out():
    events = made_of([(5, 7)] * 20 + [(20, 10), (21, 10), (22, 11)])
    kept = without_hot_pixels(events, WIDTH, HEIGHT)
    np.testing.assert_array_equal(kept.x, [20, 21, 22])
    np.testing.assert_array_equal(kept.t, events.t[20:])


def test_the_sensors_corners_can_be_hot():
    corners = [(0, 0), (WIDTH - 1, 0), (0, HEIGHT - 1), (WIDTH - 1, HEIGHT - 1)]
    kept = without_hot_pixels(made_of([*corners * 10, (20, 10)]), WIDTH, HEIGHT)
    np.testing.assert_array_equal(kept.x, [20])


def test_edges_that_fire_often_stay_even_at_the_border():
    events = made_of(edge())
    assert without_hot_pixels(events, WIDTH, HEIGHT) is events


def test_five_events_are_not_too_many():
    assert len(without_hot_pixels(made_of([(5, 7)] * 5), WIDTH, HEIGHT)) == 5
    assert len(without_hot_pixels(made_of([(5, 7)] * 6), WIDTH, HEIGHT)) == 0


def test_half_of_the_neighbours_events_are_allowed_besides():
    around = [(4, 7)] * 4 + [(6, 8)] * 4
    assert len(without_hot_pixels(made_of(around + [(5, 7)] * 9), WIDTH, HEIGHT)) == 17
    assert len(without_hot_pixels(made_of(around + [(5, 7)] * 10), WIDTH, HEIGHT)) == 8


def test_no_events_are_none_left_out():
    assert len(without_hot_pixels(made_of(np.zeros((0, 2), int)), WIDTH, HEIGHT)) == 0
