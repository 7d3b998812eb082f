"""Events of overlapping windows, each counted once, against sets of their numbers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emoflow_ros.core.stream.bounded_windows import DistinctEvents
from emoflow_ros.core.types.events import Events, Window, WindowPolicy, WindowSlicer

MS = 1_000_000


def numbered(times_ms) -> Events:
    """Events at these times, numbered by x."""
    t = np.asarray(times_ms, np.int64) * MS
    number = np.arange(len(t), dtype=np.uint16)
    return Events(number, number, t, np.ones(len(t), np.bool_))


def count(windows: list[Window]) -> int:
    covered = DistinctEvents()
    for window in windows:
        covered.add(window)
    return covered.count


POLICIES = [
    WindowPolicy(duration_ms=10),
    WindowPolicy(duration_ms=10, stride_ms=5),
    WindowPolicy(duration_ms=10, stride_ms=1),
    WindowPolicy(count=8),
    WindowPolicy(count=8, count_stride=4),
]


@pytest.mark.parametrize("policy", POLICIES, ids=str)
def test_every_event_of_the_windows_counts_once(policy):
    windows = WindowSlicer(policy).push(numbered(range(100)))
    distinct = {int(x) for w in windows for x in w.events.x}
    assert count(windows) == len(distinct) > 80
    overlapping = policy.count_stride or policy.stride_ns < policy.duration_ns
    assert (sum(len(w.events) for w in windows) > 1.5 * len(distinct)) == bool(overlapping)


@settings(max_examples=60)
@given(
    st.lists(st.integers(0, 60), min_size=30, max_size=80).map(sorted),
    st.sampled_from([POLICIES[i] for i in (0, 1, 2, 3)]),
)
def test_events_at_the_same_time(times, policy):
    windows = WindowSlicer(policy).push(numbered(times))
    assert count(windows) == len({int(x) for w in windows for x in w.events.x})


def test_empty_windows_and_gaps():
    events = numbered([0, 1, 2, 50, 51, 52])
    windows = [
        Window(0, 3 * MS, events[:3]),
        Window(10 * MS, 20 * MS, Events.empty()),
        Window(50 * MS, 52 * MS, events[3:5]),
        Window(51 * MS, 53 * MS, events[4:]),
    ]
    assert count(windows) == 6
