"""Point tracks against flows whose paths are known in closed form."""

import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate, Quality, Status
from emoflow_ros.core.lattice import Lattice, LatticeFlow
from emoflow_ros.offline.tracks import INSTANTS, Tracker, spread_points
from emoflow_ros.offline.truth import TrueFlow, Truth

CAMERA = Camera(120, 90, 100.0, 100.0, 59.5, 44.5)
MS = 1_000_000
START = 5_000_000_000


class ConstantFlow:
    """The same velocity (px/s) everywhere."""

    def __init__(self, velocity):
        self.velocity = np.array(velocity, float)

    def tracks(self, points, times):
        since = (np.array(times) - times[0]) / 1e9
        return points + since[:, None, None] * self.velocity


class ConstantTruth:
    description = "test"

    def __init__(self, velocity, unknown=()):
        self.velocity = np.array(velocity, float)
        self.unknown = unknown

    def displacement(self, t0, t1):
        if t0 in self.unknown:
            return None
        flow = np.full((90, 120, 2), self.velocity * (t1 - t0) / 1e9)
        return TrueFlow(flow.astype(np.float32), np.ones((90, 120), bool))


def estimate(start_ms, end_ms, flow):
    t0, t1 = START + start_ms * MS, START + end_ms * MS
    status = Status.NO_MOTION if flow is None else Status.OK
    return Estimate(t0, t1, (t0 + t1) // 2, status, Quality(events=1), flow=flow)


@pytest.mark.parametrize("count", [1, 2, 7, 48, 200])
def test_points_are_spread_evenly(count):
    points = spread_points(count, 120, 90)
    assert points.shape == (count, 2)
    assert ((points >= 0) & (points <= (119, 89))).all()
    np.testing.assert_allclose(points.mean(axis=0), (59.5, 44.5), atol=60 / np.sqrt(count))
    if count > 1:
        distances = np.linalg.norm(points[:, None] - points, axis=-1) + 1e9 * np.eye(count)
        assert distances.min() > 0.6 * np.sqrt(120 * 90 / count)


def test_twelve_points_are_a_grid():
    points = spread_points(12, 120, 90)
    x, y = np.meshgrid([14.5, 44.5, 74.5, 104.5], [14.5, 44.5, 74.5])
    np.testing.assert_allclose(points, np.stack([x, y], -1).reshape(-1, 2))


def test_constant_flow_over_three_windows():
    """Straight lines through all windows; who leaves the image ends, and begins anew."""
    tracker, flow = Tracker(12, CAMERA), ConstantFlow((100.0, 0.0))
    first = spread_points(12, 120, 90)
    windows = [tracker.follow(estimate(k * 80, (k + 1) * 80, flow), Truth()) for k in range(3)]
    for k, tracks in enumerate(windows):
        np.testing.assert_array_equal(
            tracks.times, START + (k * 80 + np.arange(INSTANTS) * 10) * MS
        )
        np.testing.assert_array_equal(tracks.ids[:3], [0, 1, 2])
        path = first[:3] + ((k * 80 + 10 * np.arange(INSTANTS)) / 10)[:, None, None] * (1, 0)
        np.testing.assert_allclose(tracks.positions[:, :3], path)
        assert tracks.errors is None
    # Column 4 begins at x = 104.5 and passes 119 after 145 ms: in the second window's 7th instant.
    second, third = windows[1], windows[2]
    assert np.isfinite(second.positions[:7, 3::4]).all()
    assert np.isnan(second.positions[7:, 3::4]).all()
    assert third.ids.tolist() == [0, 1, 2, 12, 4, 5, 6, 13, 8, 9, 10, 14]
    np.testing.assert_allclose(third.positions[0, 3::4], first[3::4])


def test_point_that_comes_back_has_ended():
    class Swing:
        def tracks(self, points, times):
            x = np.array([0, 3, 6, 9, 12, 9, 6, 3, 0.0])
            return points + np.stack([x, 0 * x], -1)[:, None]

    tracks = Tracker(12, CAMERA).follow(estimate(0, 80, Swing()), Truth())
    assert np.isfinite(tracks.positions[:, 0]).all()  # 14.5 to 26.5
    shown = Tracker(3, CAMERA)
    shown._first[:] = (110, 10), (112, 10), (50, 10)
    path = shown.follow(estimate(0, 80, Swing()), Truth()).positions[..., 0]
    np.testing.assert_array_equal(np.isnan(path[:, 0]), np.arange(9) >= 4)
    np.testing.assert_array_equal(np.isnan(path[:, 1]), np.arange(9) >= 3)
    assert np.isfinite(path[:, 2]).all()


def test_rotating_flow_of_the_lattice_gives_arcs():
    """The field of a turn about the centre is linear: a lattice holds it, its tracks are arcs."""
    lattice = Lattice(120, 90, 7, 6)
    turn = np.radians(12.0)  # per window
    nodes = lattice.pixels.reshape(7, 6, 2) - (59.5, 44.5)
    field = turn * np.stack([-nodes[..., 1], nodes[..., 0]], -1)
    values = np.repeat(field[:, :, None], 2, axis=2).astype(np.float32)
    tracker = Tracker(30, CAMERA)
    first = spread_points(30, 120, 90) - (59.5, 44.5)
    whole = np.linalg.norm(first, axis=1) < 44
    for k in range(4):
        t0, t1 = START + k * 90 * MS, START + (k + 1) * 90 * MS
        flow = LatticeFlow(lattice, values, t0, t1)
        tracks = tracker.follow(estimate(k * 90, (k + 1) * 90, flow), Truth())
        for i, angle in enumerate(turn * (k + np.linspace(0, 1, INSTANTS))):
            c, s = np.cos(angle), np.sin(angle)
            arc = first[whole] @ np.array([[c, s], [-s, c]]) + (59.5, 44.5)
            np.testing.assert_allclose(tracks.positions[i, whole], arc, atol=0.05)
    assert (tracks.ids[whole] < 30).all()


def test_overlapping_windows_go_on_where_the_points_were():
    tracker, flow = Tracker(12, CAMERA), ConstantFlow((0.0, -50.0))
    first = spread_points(12, 120, 90)
    for k in range(4):  # windows of 80 ms every 33 ms
        tracks = tracker.follow(estimate(k * 33, k * 33 + 80, flow), Truth())
        expected = first[4:, 1] - 0.05 * k * 33
        np.testing.assert_allclose(tracks.positions[0, 4:, 1], expected)
    assert tracks.ids[4:].tolist() == list(range(4, 12))


def test_gaps_and_windows_without_flow_begin_new_tracks():
    tracker, flow = Tracker(4, CAMERA), ConstantFlow((10.0, 0.0))
    first = spread_points(4, 120, 90)
    assert tracker.follow(estimate(0, 80, flow), Truth()).ids.tolist() == [0, 1, 2, 3]
    later = tracker.follow(estimate(81, 160, flow), Truth())
    assert later.ids.tolist() == [4, 5, 6, 7]
    np.testing.assert_array_equal(later.positions[0], first)
    nothing = tracker.follow(estimate(160, 240, None), Truth())
    assert nothing.ids.tolist() == [-1] * 4
    assert np.isnan(nothing.positions).all()
    assert tracker.follow(estimate(240, 320, flow), Truth()).ids.tolist() == [8, 9, 10, 11]


def test_errors_grow_with_the_tracks_age():
    """A flow that is (30, 40) px/s off is 5 px off after every 100 ms."""
    true, unknown = (-20.0, 10.0), START + 300 * MS
    truth = Truth(flows=ConstantTruth(true, unknown=(unknown,)))
    flow = ConstantFlow(np.add(true, (30.0, 40.0)))
    tracker = Tracker(1, CAMERA)
    for k in range(3):
        errors = tracker.follow(estimate(100 * k, 100 * (k + 1), flow), truth).errors
        assert errors.end_px == pytest.approx(5.0 * (k + 1), abs=1e-4)
        assert errors.true_px == pytest.approx(np.hypot(20, 10) * 0.1 * (k + 1), abs=1e-4)
        assert errors.age_s == pytest.approx(0.1 * (k + 1))
        assert errors.points == 1
    # Where the truth was unknown once, the rest of the track has none.
    assert tracker.follow(estimate(300, 400, flow), truth).errors is None
    assert tracker.follow(estimate(400, 500, flow), truth).errors is None


def test_errors_in_overlapping_windows():
    truth = Truth(flows=ConstantTruth((20.0, 0.0)))
    tracker = Tracker(1, CAMERA)
    for k in range(3):  # 100 ms every 40 ms
        flow = ConstantFlow((20.0, 10.0))
        errors = tracker.follow(estimate(40 * k, 40 * k + 100, flow), truth).errors
        assert errors.end_px == pytest.approx(1.0 + 0.4 * k, abs=1e-4)


def test_recent_windows_are_bounded():
    tracker = Tracker(2, CAMERA)
    for k in range(50):
        tracker.follow(estimate(10 * k, 10 * (k + 1), ConstantFlow((1.0, 0))), Truth())
    assert len(tracker.recent) == 6
    assert tracker.recent[-1].times[-1] == START + 500 * MS
