"""Slices: where events are drawn, how sharp, and how the stream is cut."""

import numpy as np
import pytest

from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import (
    GRID_PX,
    Slice,
    SliceEvents,
    drawn,
    grid_nodes,
    sharpness,
)
from emoflow_ros.core.front_end.slicing import slices
from emoflow_ros.core.types.events import NS_PER_MS, Events

SIZE = (96, 64)
ROWS, COLUMNS = grid_nodes(SIZE).shape[:2]
SPEED = 60.0  # px/s


def moving_edge(sign: float = 1.0) -> SliceEvents:
    """An upright edge that is at x = 40 in the middle of a slice of 100 ms."""
    rng = np.random.default_rng(0)
    dt = rng.uniform(-0.05, 0.05, 3000).astype(np.float32)
    y = rng.uniform(5, 58, 3000).astype(np.float32)
    x = (40 - SPEED * dt).astype(np.float32)
    return SliceEvents(0, x, y, dt, np.full(3000, sign, np.float32))


def image_along(u: float, sign: float = 1.0) -> np.ndarray:
    return drawn(moving_edge(sign), constant_flow(u), SIZE)


def constant_flow(u: float, v: float = 0.0) -> np.ndarray:
    return np.tile(np.array([u, v], np.float32), (ROWS, COLUMNS, 1))


def test_events_along_the_true_flow_lie_where_the_edge_is_in_the_middle():
    columns = image_along(SPEED).sum(axis=0)
    assert columns @ np.arange(SIZE[0]) / columns.sum() == pytest.approx(40, abs=0.02)
    assert columns.sum() == pytest.approx(3000, rel=1e-3)
    assert columns[37:44].sum() == pytest.approx(3000, rel=1e-3)


def test_the_true_flow_is_the_sharpest():
    sharp = [sharpness(image_along(u)) for u in (0, 30, 60, 90)]
    assert sharp[2] == max(sharp)
    assert sharp[2] > 2 * sharp[0]


def test_off_events_are_negative():
    assert np.array_equal(image_along(SPEED), -image_along(SPEED, sign=-1.0))


def test_the_half_image_is_the_mean_of_the_full_one():
    picture = Slice.of(0, image_along(SPEED), constant_flow(SPEED))
    columns = picture.half.image.sum(axis=0)
    assert 4 * columns.sum() == pytest.approx(3000, rel=0.02)
    middle = columns @ np.arange(len(columns)) / columns.sum()
    assert 2 * middle + 0.5 == pytest.approx(40, abs=0.1)


def test_events_carried_off_the_image_are_left_out():
    assert np.abs(image_along(1e6)).sum() < 30


def test_the_nodes_of_a_flow_cover_the_image():
    nodes = grid_nodes(SIZE)
    assert nodes.shape == (9, 13, 2)
    assert nodes[1, 2].tolist() == [2 * GRID_PX, GRID_PX]
    assert nodes[-1, -1].tolist() == [95, 63]


def stream(seconds: float = 0.3) -> Events:
    t = np.arange(0, round(seconds * 1e9), 10_000)
    return Events(
        (np.arange(len(t)) % 90).astype(np.uint16), (np.arange(len(t)) % 60).astype(np.uint16), t,
        np.ones(len(t), np.bool_),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("speed", "most", "number", "length_ms"),
    [
        (400.0, 2, 2, 33.75),
        (400.0, 4, 4, 16.875),
        (100.0, 2, 2, 33.75),
        (100.0, 4, 2, 33.75),
        (50.0, 2, 1, 80.0),
        (10.0, 2, 1, 100.0),
    ],
)
def test_slices_are_as_long_as_the_motion_takes_for_some_pixels(speed, most, number, length_ms):
    since, until = 200 * NS_PER_MS, 267_500_000
    flow, settings = constant_flow(speed), FrontEndSettings()
    made = list(slices(stream(), since, until, flow, np.ones(2), most, settings))
    assert len(made) == number
    ends = [round(s.t + 1e9 * max(0.0, -float(s.dt.min()))) for s in made]
    assert ends[-1] == pytest.approx(until, abs=20_000)
    for s in made:
        assert float(s.dt.max() - s.dt.min()) * 1e3 == pytest.approx(length_ms, abs=0.1)


def test_after_a_gap_no_slice_is_longer_than_the_longest():
    settings = FrontEndSettings()
    since, until, flow = 50 * NS_PER_MS, 350 * NS_PER_MS, constant_flow(40.0)
    made = list(slices(stream(0.4), since, until, flow, np.ones(2), 2, settings))
    assert len(made) == 2
    for s in made:
        assert float(s.dt.max() - s.dt.min()) == pytest.approx(settings.longest_slice_s, abs=1e-4)


def test_a_slice_before_the_first_event_is_left_out():
    made = list(
        slices(
            stream(), -200 * NS_PER_MS, 0, constant_flow(100.0), np.ones(2), 2, FrontEndSettings()
        )
    )
    assert made == []


def test_large_slices_are_thinned_evenly():
    settings = FrontEndSettings(most_events=500)
    (made,) = slices(
        stream(), 200 * NS_PER_MS, 267_500_000, constant_flow(50.0), np.ones(2), 2, settings
    )
    assert len(made.x) == 500
    assert np.diff(np.sort(made.dt)).max() < 2e-3
