"""Point tracks against flows whose paths are known in closed form."""

import numpy as np
import pytest
from constant_flow import ConstantFlow

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.products.pictures import (
    INSTANTS,
    Tracker,
    Tracks,
    interpolate,
    spread_points,
    trails,
    trails_at_unit_depth,
)

MS = 1_000_000
START = 5_000_000_000
CENTRE = (59.5, 44.5)


class Swing:
    """12 px to the right and back."""

    def tracks(self, points, times):
        x = np.array([0, 3, 6, 9, 12, 9, 6, 3, 0.0])
        return points + np.stack([x, 0 * x], -1)[:, None]


def follow(tracker, flow, start_ms, end_ms):
    return tracker.follow(flow, START + start_ms * MS, START + end_ms * MS)


@pytest.mark.parametrize("count", [1, 2, 7, 48, 200])
def test_points_are_spread_evenly(count):
    points = spread_points(count, 120, 90)
    assert points.shape == (count, 2)
    assert ((points >= 0) & (points <= (119, 89))).all()
    np.testing.assert_allclose(points.mean(axis=0), CENTRE, atol=60 / np.sqrt(count))
    if count > 1:
        distances = np.linalg.norm(points[:, None] - points, axis=-1) + 1e9 * np.eye(count)
        assert distances.min() > 0.6 * np.sqrt(120 * 90 / count)


def test_twelve_points_are_a_grid():
    points = spread_points(12, 120, 90)
    x, y = np.meshgrid([14.5, 44.5, 74.5, 104.5], [14.5, 44.5, 74.5])
    np.testing.assert_allclose(points, np.stack([x, y], -1).reshape(-1, 2))


def test_constant_flow_over_three_windows():
    """Straight lines through all windows; who leaves the image ends, and begins anew."""
    tracker, flow = Tracker(12, 120, 90), ConstantFlow((100.0, 0.0))
    first = spread_points(12, 120, 90)
    windows = [follow(tracker, flow, k * 80, (k + 1) * 80) for k in range(3)]
    for k, tracks in enumerate(windows):
        np.testing.assert_array_equal(
            tracks.times, START + (k * 80 + np.arange(INSTANTS) * 10) * MS
        )
        np.testing.assert_array_equal(tracks.ids[:3], [0, 1, 2])
        path = first[:3] + ((k * 80 + 10 * np.arange(INSTANTS)) / 10)[:, None, None] * (1, 0)
        np.testing.assert_allclose(tracks.positions[:, :3], path)
    # Column 4 begins at x = 104.5 and passes 119 after 145 ms: in the second window's 7th instant.
    second, third = windows[1], windows[2]
    assert np.isfinite(second.positions[:7, 3::4]).all()
    assert np.isnan(second.positions[7:, 3::4]).all()
    assert third.ids.tolist() == [0, 1, 2, 12, 4, 5, 6, 13, 8, 9, 10, 14]
    np.testing.assert_allclose(third.positions[0, 3::4], first[3::4])


def test_point_that_comes_back_has_ended():
    tracks = follow(Tracker(12, 120, 90), Swing(), 0, 80)
    assert np.isfinite(tracks.positions[:, 0]).all()  # 14.5 to 26.5
    shown = Tracker(3, 120, 90)
    shown.first[:] = (110, 10), (112, 10), (50, 10)
    path = follow(shown, Swing(), 0, 80).positions[..., 0]
    np.testing.assert_array_equal(np.isnan(path[:, 0]), np.arange(9) >= 4)
    np.testing.assert_array_equal(np.isnan(path[:, 1]), np.arange(9) >= 3)
    assert np.isfinite(path[:, 2]).all()


def test_rotating_flow_of_the_lattice_gives_arcs():
    """The field of a turn about the centre is linear: a lattice holds it, its tracks are arcs."""
    lattice = Lattice(120, 90, 7, 6)
    turn = np.radians(12.0)  # per window
    nodes = lattice.pixels.reshape(7, 6, 2) - CENTRE
    field = turn * np.stack([-nodes[..., 1], nodes[..., 0]], -1)
    values = np.repeat(field[:, :, None], 2, axis=2).astype(np.float32)
    tracker = Tracker(30, 120, 90)
    first = spread_points(30, 120, 90) - CENTRE
    whole = np.linalg.norm(first, axis=1) < 44
    for k in range(4):
        t0, t1 = START + k * 90 * MS, START + (k + 1) * 90 * MS
        tracks = tracker.follow(LatticeFlow(lattice, values, t0, t1), t0, t1)
        for i, angle in enumerate(turn * (k + np.linspace(0, 1, INSTANTS))):
            c, s = np.cos(angle), np.sin(angle)
            arc = first[whole] @ np.array([[c, s], [-s, c]]) + CENTRE
            np.testing.assert_allclose(tracks.positions[i, whole], arc, atol=0.05)
    assert (tracks.ids[whole] < 30).all()


def test_overlapping_windows_go_on_where_the_points_were():
    tracker, flow = Tracker(12, 120, 90), ConstantFlow((0.0, -50.0))
    first = spread_points(12, 120, 90)
    for k in range(4):  # windows of 80 ms every 33 ms
        tracks = follow(tracker, flow, k * 33, k * 33 + 80)
        expected = first[4:, 1] - 0.05 * k * 33
        np.testing.assert_allclose(tracks.positions[0, 4:, 1], expected)
    assert tracks.ids[4:].tolist() == list(range(4, 12))


def test_gaps_and_windows_without_flow_begin_new_tracks():
    tracker, flow = Tracker(4, 120, 90), ConstantFlow((10.0, 0.0))
    first = spread_points(4, 120, 90)
    assert follow(tracker, flow, 0, 80).ids.tolist() == [0, 1, 2, 3]
    later = follow(tracker, flow, 81, 160)
    assert later.ids.tolist() == [4, 5, 6, 7]
    np.testing.assert_array_equal(later.positions[0], first)
    nothing = follow(tracker, None, 160, 240)
    assert nothing.ids.tolist() == [-1] * 4
    assert np.isnan(nothing.positions).all()
    assert follow(tracker, flow, 240, 320).ids.tolist() == [8, 9, 10, 11]


def test_jump_back_in_time_begins_new_tracks():
    tracker, flow = Tracker(4, 120, 90), ConstantFlow((10.0, 0.0))
    follow(tracker, flow, 1000, 1080)
    assert follow(tracker, flow, 0, 80).ids.tolist() == [4, 5, 6, 7]


def test_path_is_straight_between_two_instants():
    times = np.array([0, 10, 20])
    path = np.array([[[0.0, 0.0]], [[10.0, 5.0]], [[np.nan, np.nan]]])
    np.testing.assert_allclose(interpolate(times, path, 4), [[4.0, 2.0]])
    np.testing.assert_allclose(interpolate(times, path, 10), [[10.0, 5.0]])
    assert np.isnan(interpolate(times, path, 11)).all()


def test_tracks_end_after_the_longest_time_at_different_windows():
    tracker, flow = Tracker(40, 120, 90, longest=4), ConstantFlow((10.0, 0.0))
    begun = np.full(40, -1)
    ids = np.full(40, -1)
    for k in range(12):
        found = follow(tracker, flow, 10 * k, 10 * (k + 1)).ids
        new = found != ids
        if k:
            assert new.sum() == 10
        if k >= 4:
            np.testing.assert_array_equal(k - begun[new], 4)
        begun[new], ids = k, found


def test_trails_join_the_windows_up_to_the_last_ones_end():
    """10 px per window of 80 ms; the tracks of the last column have just begun."""
    tracker, flow = Tracker(12, 120, 90), ConstantFlow((125.0, 0.0))
    windows = [follow(tracker, flow, k * 80, (k + 1) * 80) for k in range(3)]
    segments, ages = trails(windows)
    assert segments.shape == (9 * 8 * 3 + 3 * 8, 2, 2)
    assert ages.shape == (len(segments), 2)
    x = segments[..., 0][np.isclose(segments[..., 1], 14.5).all(axis=1) & (segments[:, 0, 0] < 44)]
    np.testing.assert_allclose(np.sort(x[:, 0]), 14.5 + 1.25 * np.arange(24))
    np.testing.assert_allclose(x[:, 1] - x[:, 0], 1.25)
    np.testing.assert_allclose(ages[:, 0] - ages[:, 1], 0.01)
    assert ages.max() == pytest.approx(0.24)
    assert ages.min() == 0.0


def test_later_windows_count_where_they_overlap():
    tracker = Tracker(1, 120, 90)
    windows = [
        follow(tracker, ConstantFlow((10.0, 0.0)), 0, 80),
        follow(tracker, ConstantFlow((0.0, 10.0)), 40, 120),
    ]
    segments, ages = trails(windows)
    np.testing.assert_allclose(ages[0], [0.12, 0.11])
    assert len(segments) == 4 + 8
    np.testing.assert_allclose(segments[:4, 1] - segments[:4, 0], [[0.1, 0.0]] * 4, atol=1e-9)
    np.testing.assert_allclose(segments[4:, 1] - segments[4:, 0], [[0.0, 0.1]] * 8, atol=1e-9)


def test_trails_lie_on_the_bearings_of_their_pixels():
    """A path that stands still for half a window, through a lens with distortion."""
    camera = Camera(120, 90, 100.0, 80.0, 60.0, 45.0, "plumb_bob", (-0.2, 0.0, 0.01, 0.0))
    x = np.array([10, 10, 10, 10, 10, 40, 50, 60, 70.0])
    positions = np.stack([x, np.full(9, 30.0)], -1)[:, None]
    lines = trails_at_unit_depth([Tracks(np.arange(9) * MS, positions, np.zeros(1, int))], camera)
    assert lines.shape == (2, 2, 4)
    np.testing.assert_array_equal(lines[..., 2], 1.0)
    np.testing.assert_allclose(lines[..., 3], [[0.0, 0.5], [0.5, 1.0]], atol=1e-6)
    seen = camera.project(lines[..., :3].astype(float))
    np.testing.assert_allclose(seen[0], [[10, 30], [10, 30]], atol=1e-4)
    np.testing.assert_allclose(seen[1], [[10, 30], [70, 30]], atol=1e-4)


def test_trails_end_where_a_point_leaves_the_image():
    camera = Camera(120, 90, 100.0, 100.0, 60.0, 45.0)
    positions = np.full((9, 2, 2), 60.0)
    positions[5:, 0] = np.nan
    positions[:, 1] = np.nan
    lines = trails_at_unit_depth([Tracks(np.arange(9), positions, np.zeros(2, int))], camera)
    np.testing.assert_allclose(lines[..., :3], np.tile(np.float32([0, 0.15, 1]), (1, 2, 1)))
