"""Windows by motion in the worker: what a bag gives without ROS, bit by bit."""

import time

import numpy as np
from supervisor_bench import next_outcome

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.present_motion import PresentMotion
from emoflow_ros.core.stream.bounded_windows import RateLimitedSlicer
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events
from emoflow_ros.factory import make_estimator
from emoflow_ros.node.supervisor import Supervisor
from emoflow_ros.node.tasks import Job, Present, Result, Task

CAMERA = Camera(240, 180, 200.0, 200.0, 120.0, 90.0)
SPEEDS = np.array([150.0, 600.0])  # px/s, in the first and the last 200 ms
CONFIG = load_config(
    overrides={
        "window.duration_ms": 90.0,
        "window.stride_ms": 45.0,
        "window.max_displacement_px": 9.0,
        "window.min_count": 5000,
        "estimator.max_events": 5000,
    }
)


def moving_dots() -> Events:
    """Dots that move right, faster from 200 ms on, with 1000 events per pixel of the way."""
    rng = np.random.default_rng(0)
    way = np.concatenate([[0.0], np.cumsum(SPEEDS * 0.2)])
    moved = np.sort(rng.uniform(0, way[-1], int(1000 * way[-1])))
    t = np.interp(moved, way, 200.0 * NS_PER_MS * np.arange(3)).astype(np.int64)
    dots = rng.integers(0, (CAMERA.width, CAMERA.height), (400, 2))
    dot = rng.integers(0, len(dots), len(t))
    x = (dots[dot, 0] + moved.astype(np.int64)) % CAMERA.width
    return Events(x.astype(np.uint16), dots[dot, 1].astype(np.uint16), t, dot % 2 == 0)


def test_the_worker_cuts_and_estimates_what_is_cut_and_estimated_without_it() -> None:
    budget = EventBudget(CONFIG.window, CONFIG.estimator.max_events)
    windows = RateLimitedSlicer(budget).push(moving_dots())
    estimator = make_estimator(CAMERA, CONFIG)
    expected = [estimator.estimate(window) for window in windows]
    assert [e.status for e in expected] == [Status.OK] * 7
    lengths = [(e.t_end - e.t_start) / NS_PER_S for e in expected]
    assert 0.045 < lengths[2] < 0.08 and lengths[-1] < 0.025  # 60 and 15 ms for 9 px

    supervisor = Supervisor(
        capacity=len(windows), timeout_s=60.0, may_use_cpu=False, wake=lambda: None
    )
    for window in windows:
        task = Task(window, 0, 0, "camera", time.monotonic())
        supervisor.queue.put([Job(task, CAMERA, CONFIG)])
    supervisor.start()
    try:
        for its in expected:
            result = next_outcome(supervisor)
            assert isinstance(result, Result), result
            mine = result.estimate
            assert (mine.t_start, mine.t_end, mine.t) == (its.t_start, its.t_end, its.t)
            for name in ("linear", "angular", "covariance"):
                np.testing.assert_array_equal(getattr(mine, name), getattr(its, name))
    finally:
        supervisor.stop()


def test_the_worker_estimates_the_latest_twist_as_it_is_estimated_without_it() -> None:
    budget = EventBudget(CONFIG.window, CONFIG.estimator.max_events)
    windows = RateLimitedSlicer(budget).push(moving_dots())
    estimator, present = make_estimator(CAMERA, CONFIG), PresentMotion(CAMERA, CONFIG.estimator)
    estimates = [estimator.estimate(window) for window in windows]
    present.know(estimates[-1])
    newest = windows[-1].since(windows[-1].t_end - 60 * NS_PER_MS)
    expected = present.estimate(newest)
    assert expected is not None

    supervisor = Supervisor(
        capacity=len(windows), timeout_s=60.0, may_use_cpu=False, wake=lambda: None
    )
    slices = Task(newest, 0, 0, "camera", 0.0, is_slice=True)
    for window in windows:
        supervisor.queue.put([Job(Task(window, 0, 0, "camera", 0.0), CAMERA, CONFIG)])
    supervisor.start()
    try:
        for _ in windows:
            assert isinstance(next_outcome(supervisor), Result)
        supervisor.slices.put([slices])
        found = next_outcome(supervisor)
        assert isinstance(found, Present), found
        assert found.task is slices
        assert found.found.twist.t == newest.t_end
        np.testing.assert_array_equal(found.found.twist.angular, expected.twist.angular)
        np.testing.assert_array_equal(found.found.twist.linear, expected.twist.linear)
        np.testing.assert_array_equal(found.found.covariance, expected.covariance)
    finally:
        supervisor.stop()
