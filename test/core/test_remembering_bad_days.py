"""The estimator with a memory after a bad time: no exception, and right again soon."""

import numpy as np
import pytest
from test_remembering import Run, estimates_of, run_of, windows_of

from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import NS_PER_MS, Events


@pytest.fixture(scope="module")
def calm() -> Run:
    return run_of("calm")


def noise(count: int, t0: int, t1: int, size: tuple[int, int]) -> Events:
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(t0, t1, count))
    x, y = (rng.integers(0, n, count).astype(np.uint16) for n in size)
    return Events(x, y, t, rng.random(count) < 0.5)


def one_line(count: int, t0: int, t1: int) -> Events:
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(t0, t1, count))
    x = (20 + 300 * ((t - t0) / (t1 - t0))).astype(np.uint16)
    return Events(x, np.full(count, 130, np.uint16), t, np.ones(count, np.bool_))


@pytest.mark.parametrize("bad", ["noise", "one line", "half lost", "one patch"])
def test_a_bad_time_ends_in_no_exception_and_is_over_soon_after(calm: Run, bad: str):
    events = calm.recording.events
    t0 = int(events.t[0])
    begin, end = t0 + 270 * NS_PER_MS, t0 + 400 * NS_PER_MS
    inside = (events.t >= begin) & (events.t < end)
    rng = np.random.default_rng(1)
    if bad == "half lost":
        instead = events[inside & (rng.random(len(events)) < 0.5)]
    elif bad == "one patch":
        near = (np.abs(events.x.astype(int) - 170) < 15) & (np.abs(events.y.astype(int) - 130) < 15)
        instead = events[inside & near]
    elif bad == "noise":
        instead = noise(int(inside.sum()), begin, end, calm.recording.camera.size)
    else:
        instead = one_line(int(inside.sum()), begin, end)
    disturbed = Events.concatenate([events[events.t < begin], instead, events[events.t >= end]])
    estimates = estimates_of(calm.recording, windows_of(disturbed))
    for e in estimates:
        if e.status is Status.OK:
            assert np.isfinite(e.angular).all()
            assert np.isfinite(e.covariance).all()
    after = [e for e in estimates if e.t_end > end + 300 * NS_PER_MS]
    errors = [calm.error(e) for e in after]
    assert all(e.status is Status.OK for e in after)
    assert np.median(errors) < 2.5
