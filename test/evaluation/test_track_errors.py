"""Point tracks beside truths that are known in closed form."""

import numpy as np
import pytest
from constant_flow import ConstantFlow

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.evaluation.track_errors import TrackComparer
from emoflow_ros.truth import TrueFlow, Truth

CAMERA = Camera(120, 90, 100.0, 100.0, 59.5, 44.5)
MS = 1_000_000
START = 5_000_000_000


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


def test_new_tracks_begin_with_the_truth():
    """After a gap and a window without a flow the age and the true displacement start again."""
    truth = Truth(flows=ConstantTruth((20.0, 0.0)))
    tracker, flow = TrackComparer(4, CAMERA), ConstantFlow((20.0, 10.0))
    assert tracker.follow(estimate(0, 100, flow), truth).errors.end_px == pytest.approx(1.0)
    later = tracker.follow(estimate(101, 201, flow), truth)
    assert later.ids.tolist() == [4, 5, 6, 7]
    assert later.errors.age_s == pytest.approx(0.1)
    assert later.errors.true_px == pytest.approx(2.0)
    nothing = tracker.follow(estimate(201, 300, None), truth)
    assert nothing.errors is None
    assert np.isnan(nothing.true_ends).all()
    assert len(tracker.recent) == 0
    again = tracker.follow(estimate(300, 400, flow), truth)
    assert again.errors.end_px == pytest.approx(1.0)
    assert len(tracker.recent) == 1


def test_errors_grow_with_the_tracks_age():
    """A flow that is (30, 40) px/s off is 5 px off after every 100 ms."""
    true, unknown = (-20.0, 10.0), START + 300 * MS
    truth = Truth(flows=ConstantTruth(true, unknown=(unknown,)))
    flow = ConstantFlow(np.add(true, (30.0, 40.0)))
    tracker = TrackComparer(1, CAMERA)
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
    tracker = TrackComparer(1, CAMERA)
    for k in range(3):  # 100 ms every 40 ms
        flow = ConstantFlow((20.0, 10.0))
        errors = tracker.follow(estimate(40 * k, 40 * k + 100, flow), truth).errors
        assert errors.end_px == pytest.approx(1.0 + 0.4 * k, abs=1e-4)


def test_recent_windows_are_bounded():
    tracker = TrackComparer(2, CAMERA)
    for k in range(50):
        tracker.follow(estimate(10 * k, 10 * (k + 1), ConstantFlow((1.0, 0))), Truth())
    assert len(tracker.recent) == 6
    assert tracker.recent[-1].times[-1] == START + 500 * MS
