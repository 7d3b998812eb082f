"""Windows of a stream with more events than they may hold: the same however it comes."""

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emoflow_ros.core.stream.bounded_windows import (
    BoundedWindows,
    DistinctEvents,
    RateLimitedSlicer,
)
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events, TimeJumpError, Window, WindowPolicy, WindowSlicer

MS = 1_000_000
START = 5 * 10**17
BY_MOTION = WindowPolicy(duration_ms=30.0, stride_ms=10.0, max_displacement_px=20.0)
POLICIES = [
    BY_MOTION,
    WindowPolicy(duration_ms=10.0),
    WindowPolicy(duration_ms=10.7, stride_ms=4.0),
    WindowPolicy(duration_ms=8.0, stride_ms=3.0, max_displacement_px=5.0),
]


def stream(count: int, seed: int, seconds: float = 0.08) -> Events:
    """Events in bursts, and a silence of 25 ms among them."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([rng.uniform(0, seconds, count // 2), rng.normal(0.06, 0.001, count // 2)])
    t = np.sort(np.where(t > 0.03, t + 0.025, t).clip(0))
    x, y = rng.integers(0, 320, (2, len(t))).astype(np.uint16)
    return Events(x, y, START + (t * 1e6).astype(np.int64) * 1000, rng.random(len(t)) < 0.5)


def assert_same(one: list[Window], other: list[Window]) -> None:
    assert [(w.t_start, w.t_end) for w in one] == [(w.t_start, w.t_end) for w in other]
    for a, b in zip(one, other, strict=True):
        for name in ("x", "y", "t", "p"):
            np.testing.assert_array_equal(getattr(a.events, name), getattr(b.events, name))
        stands = [
            np.ones(len(w.events)) if w.events.stands_for is None else w.events.stands_for
            for w in (a, b)
        ]
        np.testing.assert_array_equal(*stands)


@settings(max_examples=60)
@given(
    st.integers(0, 10**6),
    st.sampled_from(POLICIES),
    st.sampled_from([40, 400, 4000]),
    st.lists(st.integers(1, 3000), max_size=25),
)
def test_thinning_on_the_way_gives_the_thinned_windows(seed, policy, max_events, sizes):
    events = stream(10_000, seed)
    budget = EventBudget(policy, max_events)
    expected = [budget.thin(window) for window in WindowSlicer(policy).push(events)]
    slicer, windows = RateLimitedSlicer(budget), []
    for part in np.split(np.arange(len(events)), np.minimum(np.cumsum(sizes), len(events))):
        windows += [budget.bound(window) for window in slicer.push(events[part])]
    assert_same(windows, expected)
    assert len(windows) > 2
    assert slicer.left_out > 0 or max_events == 4000


@settings(max_examples=30)
@given(
    st.integers(0, 10**6),
    st.sampled_from(POLICIES),
    st.sampled_from([1, 5]),
    st.lists(st.integers(1, 3000), max_size=25),
)
def test_limiting_the_rate_on_the_way_limits_that_of_the_windows(seed, policy, bin_ms, sizes):
    events = stream(10_000, seed)
    budget = EventBudget(policy, 400, bin_ms * MS)
    expected = [
        replace(window, events=budget.limit_rate(window.events, window.t_start))
        for window in WindowSlicer(policy).push(events)
    ]
    slicer, windows = RateLimitedSlicer(budget), []
    for part in np.split(np.arange(len(events)), np.minimum(np.cumsum(sizes), len(events))):
        windows += slicer.push(events[part])
    assert_same(windows, expected)
    most = 400 * policy.duration_ns / min(10 * MS, policy.duration_ns)
    assert max(len(w.events) for w in windows) <= most
    assert slicer.left_out > 0


def test_windows_come_with_the_event_that_completes_them():
    policy = WindowPolicy(duration_ms=10.0, stride_ms=5.0)
    events = stream(10_000, 1)
    plain, limited = WindowSlicer(policy), RateLimitedSlicer(EventBudget(policy, 100))
    for i in range(0, len(events), 50):
        part = events[i : i + 50]
        assert [w.t_end for w in limited.push(part)] == [w.t_end for w in plain.push(part)]


def test_what_is_left_out_is_counted_and_not_kept():
    slicer = RateLimitedSlicer(EventBudget(BY_MOTION, 2000))  # 200 per ms
    rng = np.random.default_rng(0)
    kept = 0
    for ms in range(29):
        t = START + ms * MS + np.arange(10_000) * MS // 10_000
        x, y = rng.integers(0, 320, (2, 10_000)).astype(np.uint16)
        assert slicer.push(Events(x, y, t, x > 100)) == []
        kept = sum(map(len, slicer._parts))
        assert kept <= 200 * ms + 10_000  # the open bin is whole
    assert slicer.left_out == 28 * 9800
    assert kept + slicer.left_out == 290_000


def test_windows_by_count_are_not_thinned():
    policy = WindowPolicy(count=3000)
    slicer = RateLimitedSlicer(EventBudget(policy, 100))
    windows = slicer.push(stream(10_000, 2))
    assert [len(w.events) for w in windows] == [3000] * 3
    assert slicer.left_out == 0


def test_a_jump_back_keeps_nothing_and_the_next_stream_is_cut_anew():
    slicer = RateLimitedSlicer(EventBudget(POLICIES[1], 400))
    events = stream(10_000, 3)
    slicer.push(events)
    with pytest.raises(TimeJumpError):
        slicer.push(events)
    left_out = slicer.left_out
    slicer.reset()
    windows = slicer.push(events)
    assert_same(windows, RateLimitedSlicer(slicer.budget).push(events))
    assert slicer.left_out == 2 * left_out > 0


@pytest.mark.parametrize("policy", POLICIES[:3], ids=str)
def test_events_of_thinned_windows_count_once_as_they_came(policy):
    events = stream(10_000, 4)
    windows = WindowSlicer(policy).push(events)
    chosen = [k for k in range(len(windows)) if k % 5 not in (1, 2)]
    plain, thinned = DistinctEvents(), DistinctEvents()
    budget = EventBudget(policy, 300)
    for k in chosen:
        plain.add(windows[k])
        thinned.add(budget.thin(windows[k]))
    assert thinned.count == plain.count > 2000


class Seen:
    def __init__(self) -> None:
        self.windows: list[Window] = []
        self.resets = 0
        self.seconds = 0.0

    def reset(self) -> None:
        self.resets += 1

    def estimate(self, window: Window) -> Estimate:
        self.windows.append(window)
        time.sleep(self.seconds)
        return Estimate(window.t_start, window.t_end, 0, Status.NO_MOTION, Quality(0))


def test_an_estimator_gets_what_the_node_would_send_it():
    events = stream(10_000, 5)
    budget = EventBudget(BY_MOTION, 500)
    seen = Seen()
    offline = BoundedWindows(seen, budget)
    for window in WindowSlicer(BY_MOTION).push(events):
        assert offline.estimate(window).status is Status.NO_MOTION
    limited = RateLimitedSlicer(budget).push(events)
    assert_same(seen.windows, [budget.bound(window) for window in limited])
    assert max(len(w.events) for w in seen.windows) <= budget.capacity < 3000
    offline.reset()
    assert seen.resets == 1


def test_the_time_of_the_whole_estimate_is_noted():
    seen = Seen()
    seen.seconds = 0.02
    window = WindowSlicer(BY_MOTION).push(stream(10_000, 5))[0]
    started = time.perf_counter()
    found = BoundedWindows(seen, EventBudget(BY_MOTION, 500)).estimate(window)
    assert 0.02 <= found.quality.runtime_s <= time.perf_counter() - started
