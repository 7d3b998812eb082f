from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from emoflow_ros.core.products.pictures import sharpened_events, warped_counts
from emoflow_ros.core.types.events import Events, Window

WIDTH, HEIGHT = 40, 20
MS = 1_000_000


class Steady:
    """A flow of (100, -50) px/s."""

    def tracks(self, points: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
        elapsed = (np.array(times) - times[0])[:, None, None] / 1e9
        return points + elapsed * np.array([100.0, -50.0])


def window_of_a_moving_point(count: int, start: tuple[int, int] = (10, 15)) -> Window:
    """Events of one point that moves by (8, -4) px in 80 ms."""
    t = np.linspace(0, 80 * MS, count, endpoint=False).astype(np.int64)
    x = np.rint(start[0] + 100 * t / 1e9).astype(np.uint16)
    y = np.rint(start[1] - 50 * t / 1e9).astype(np.uint16)
    return Window(0, 80 * MS, Events(x, y, t, np.ones(count, bool)))


@pytest.mark.parametrize("count", [800, 200_000])
def test_moving_point_becomes_one_spot_where_it_is_at_the_time(count: int) -> None:
    window = window_of_a_moving_point(count)
    image = sharpened_events(window, Steady(), 40 * MS, WIDTH, HEIGHT)
    assert image.shape == (HEIGHT, WIDTH)
    assert image.dtype == np.uint8
    y, x = np.nonzero(image)
    assert np.abs(x - 14).max() <= 1
    assert np.abs(y - 13).max() <= 1
    assert image[13, 14] == 255


def test_events_that_leave_the_image_or_have_no_flow_are_left_out() -> None:
    class Lost(Steady):
        def tracks(self, points: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
            tracks = super().tracks(points, times)
            tracks[1, points[:, 0] < 15] = np.nan
            return tracks

    window = window_of_a_moving_point(800, start=(34, 15))
    assert not sharpened_events(window, Steady(), 400 * MS, WIDTH, HEIGHT).any()
    window = window_of_a_moving_point(800)
    image = sharpened_events(window, Lost(), 40 * MS, WIDTH, HEIGHT)
    lost = np.count_nonzero(window.events.x < 15)
    assert 0 < lost < 800
    assert image[13, 14] == 255


def test_window_without_events_is_black() -> None:
    image = sharpened_events(Window(0, 80 * MS, Events.empty()), Steady(), 0, WIDTH, HEIGHT)
    assert image.shape == (HEIGHT, WIDTH)
    assert not image.any()


def test_warp_brings_the_events_of_a_moving_point_together():
    """A point that moves 8 px in 80 ms leaves one pixel after the warp."""
    window = window_of_a_moving_point(5000)
    after = warped_counts(window, Steady(), 40 * MS, WIDTH, HEIGHT)
    assert after.shape == (HEIGHT, WIDTH)
    assert after.sum() == len(window.events)
    # In the middle the point is at (14, 13).
    assert after[12:15, 13:16].sum() > 0.99 * after.sum()
    assert after[13, 14] > 0.85 * after.sum()
    still = Window(window.t_start, window.t_end, window.events[:1])
    assert warped_counts(still, Steady(), 80 * MS, WIDTH, HEIGHT)[11, 18] == 1


def test_times_since_1970_are_exact() -> None:
    start = 1_700_000_000_123_456_866  # float64 rounds it up by 30 ns
    events = Events(*np.array([[10], [15]], np.uint16), np.array([start]), np.ones(1, bool))
    counts = warped_counts(
        Window(start, start + 80 * MS, events), Steady(), start + 52 * MS, WIDTH, HEIGHT
    )
    y, x = np.nonzero(counts)
    assert x > 12 and y < 15
