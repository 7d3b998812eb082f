"""Light that flickers with the mains moves with nothing."""

import numpy as np
import pytest

from emoflow_ros.core.stream.cleaning import without_flicker
from emoflow_ros.core.types.events import Events

WIDTH, HEIGHT = 64, 48
S = 1_000_000_000


def flicker(hz: float, seconds: float, count: int, seed: int = 0) -> Events:
    """ON in the first half of each period, OFF in the second, in the upper left block."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, seconds, count))
    x, y = rng.integers(0, 16, (2, count)).astype(np.uint16)
    return Events(x, y, (t * S).astype(np.int64), (t * hz) % 1 < 0.5)


def noise(seconds: float, count: int, seed: int = 1) -> Events:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, int(seconds * S), count))
    x, y = rng.integers(0, (WIDTH, HEIGHT), (count, 2)).astype(np.uint16).T
    return Events(x, y, t, rng.random(count) < 0.5)


def edge(seconds: float, speed: float) -> Events:
    """A vertical edge that crosses the image at `speed` px/s, ON, every pixel twice."""
    x = np.repeat(np.arange(WIDTH), 2 * HEIGHT)
    y = np.tile(np.arange(HEIGHT), 2 * WIDTH)
    t = (x / speed + np.repeat([0.0, 1e-4], HEIGHT)[np.arange(len(x)) % (2 * HEIGHT)]) * S
    order = np.argsort(t, kind="stable")
    inside = order[t[order] < seconds * S]
    on = np.ones(len(inside), bool)
    return Events(x[inside].astype(np.uint16), y[inside].astype(np.uint16),
                  t[inside].astype(np.int64), on)  # fmt: skip


def together(*parts: Events) -> Events:
    joined = Events.concatenate(parts)
    return joined[np.argsort(joined.t, kind="stable")]


@pytest.mark.parametrize("hz", [100.0, 120.0])
def test_the_block_that_flickers_is_left_out(hz):
    rest = noise(0.1, 2000)
    left = without_flicker(together(rest, flicker(hz, 0.1, 1500)), WIDTH, HEIGHT)
    outside = ~((rest.x < 16) & (rest.y < 16))
    assert len(left) == np.count_nonzero(outside)
    assert not ((left.x < 16) & (left.y < 16)).any()
    np.testing.assert_array_equal(left.t, rest.t[outside])


@pytest.mark.parametrize("events", [
    noise(0.1, 5000), edge(0.1, 640.0), edge(0.1, 3000.0), flicker(33.0, 0.1, 1500),
    flicker(100.0, 0.015, 1500), flicker(100.0, 0.1, 12), Events.empty(),
])  # fmt: skip
def test_noise_edges_and_what_is_too_short_or_few_stay(events):
    assert without_flicker(events, WIDTH, HEIGHT) is events


def test_many_events_of_one_instant_before_a_gap_stay():
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, (WIDTH, HEIGHT), (200_000, 2)).astype(np.uint16).T
    t = np.zeros(200_000, np.int64)
    t[-1] = S // 10
    events = Events(x, y, t, rng.random(200_000) < 0.5)
    assert without_flicker(events, WIDTH, HEIGHT) is events
