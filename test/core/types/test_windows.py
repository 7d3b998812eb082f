from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emoflow_ros.core.types.events import Events, TimeJumpError, Window, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError

MS = 1_000_000
START = 1_500_000_000_000_000_000


def at(*times_ms: float) -> Events:
    """Events at these times, numbered by x."""
    t = START + np.round(np.array(times_ms) * MS).astype(np.int64)
    number = np.arange(len(t), dtype=np.uint16)
    return Events(number, number, t, np.ones(len(t), np.bool_))


def summary(windows: list[Window]) -> list[tuple[float, float, list[int]]]:
    """Start and end in ms, and which events."""
    return [
        ((w.t_start - START) / MS, (w.t_end - START) / MS, w.events.x.tolist()) for w in windows
    ]


def by_time(duration_ms: float, stride_ms: float = 0.0) -> WindowSlicer:
    return WindowSlicer(WindowPolicy(duration_ms=duration_ms, stride_ms=stride_ms))


def by_count(count: int, stride: int = 0) -> WindowSlicer:
    return WindowSlicer(WindowPolicy(count=count, count_stride=stride))


def test_windows_by_time_are_half_open_and_start_at_the_first_event():
    windows = by_time(10).push(at(0, 5, 9.999999, 10, 12, 20))
    assert summary(windows) == [(0, 10, [0, 1, 2]), (10, 20, [3, 4])]
    assert windows[0].duration == 0.01


def test_overlapping_windows_share_events():
    windows = by_time(10, 4).push(at(0, 3, 6, 9, 12, 15, 18))
    assert summary(windows) == [
        (0, 10, [0, 1, 2, 3]),
        (4, 14, [2, 3, 4]),
        (8, 18, [3, 4, 5]),
    ]


def test_a_window_comes_with_the_first_event_at_or_after_its_end_and_not_before():
    slicer = by_time(10)
    assert slicer.push(at(0, 4, 9.999999)) == []
    assert summary(slicer.push(at(10))) == [(0, 10, [0, 1, 2])]
    assert slicer.push(at(19)) == []
    assert summary(slicer.push(at(27))) == [(10, 20, [0, 0])]


def test_silence_is_jumped_over_in_whole_strides():
    windows = by_time(10).push(at(0, 1, 57, 61))
    assert summary(windows) == [(0, 10, [0, 1]), (50, 60, [2])]
    windows = by_time(10, 3).push(at(0, 50, 70))
    starts = [s for s, _, _ in summary(windows)]
    assert starts == [0, 42, 45, 48]  # every multiple of 3 whose window holds an event


def test_long_silence_costs_nothing():
    year_ms = 365 * 86_400_000
    windows = by_time(1).push(at(0, year_ms, year_ms + 1))
    assert [e for _, _, e in summary(windows)] == [[0], [1]]


def test_windows_by_count_end_with_the_next_event():
    windows = by_count(3).push(at(0, 1, 2, 5, 8, 9, 9))
    assert summary(windows) == [(0, 5, [0, 1, 2]), (5, 9, [3, 4, 5])]


def test_overlapping_windows_by_count():
    windows = by_count(3, 1).push(at(0, 1, 2, 5, 8))
    assert summary(windows) == [(0, 5, [0, 1, 2]), (1, 8, [1, 2, 3])]


def test_a_window_by_count_waits_for_one_event_more():
    slicer = by_count(3)
    assert slicer.push(at(0, 1, 2)) == []
    assert summary(slicer.push(at(7))) == [(0, 7, [0, 1, 2])]


def test_windows_of_simultaneous_events_have_a_length():
    (window,) = by_count(2).push(at(3, 3, 3))
    assert window.t_end - window.t_start == 1


@pytest.mark.parametrize("policy", [WindowPolicy(duration_ms=10), WindowPolicy(count=2)])
def test_going_back_in_time_is_refused_and_nothing_of_it_is_kept(policy):
    expected = summary(WindowSlicer(policy).push(at(0, 1, 9, 10, 11, 25)))
    slicer = WindowSlicer(policy)
    windows = slicer.push(at(0, 1, 9))
    with pytest.raises(TimeJumpError, match=r"went back by 0\.002000 s") as within:
        slicer.push(at(12, 10))
    assert (within.value.last, within.value.now) == (START + 12 * MS, START + 10 * MS)
    with pytest.raises(TimeJumpError, match=r"went back by 0\.008000 s") as between:
        slicer.push(at(1, 30))
    assert (between.value.last, between.value.now) == (START + 9 * MS, START + MS)
    windows += slicer.push(at(10, 11, 25))
    assert [w[:2] for w in summary(windows)] == [w[:2] for w in expected]


@pytest.mark.parametrize("policy", [WindowPolicy(duration_ms=10), WindowPolicy(count=2)])
def test_reset_forgets_events_and_time(policy):
    slicer = WindowSlicer(policy)
    slicer.push(at(100, 101))
    slicer.reset()
    assert summary(slicer.push(at(0, 2, 10))) == [(0, 10, [0, 1])]


def test_no_events_change_nothing():
    slicer = by_time(10)
    assert slicer.push(Events.empty()) == []
    slicer.push(at(0))
    assert slicer.push(Events.empty()) == []
    assert len(slicer.push(at(10))) == 1


POLICIES = st.one_of(
    st.tuples(st.integers(1, 30), st.integers(0, 30)).map(
        lambda p: WindowPolicy(duration_ms=max(p), stride_ms=min(p))
    ),
    st.tuples(st.integers(1, 12), st.integers(0, 12)).map(
        lambda p: WindowPolicy(count=max(p), count_stride=min(p))
    ),
)


@settings(max_examples=200)
@given(
    POLICIES,
    st.lists(st.one_of(st.just(0), st.integers(0, 5), st.integers(0, 200)), max_size=80),
    st.lists(st.integers(0, 80), max_size=8),
)
def test_windows_depend_neither_on_chunks_nor_on_the_future(policy, gaps_ms, cuts):
    stream = at(*np.cumsum(gaps_ms))
    whole = summary(WindowSlicer(policy).push(stream))
    slicer, chunked = WindowSlicer(policy), []
    edges = [0, *sorted(cuts), len(stream)]
    for first, last in pairwise(edges):
        for window in slicer.push(stream[first:last]):
            chunked.append(window)
            if not policy.count:  # as soon as it is complete, and no earlier
                assert stream.t[min(last, len(stream)) - 1] >= window.t_end
                assert first == 0 or stream.t[first - 1] < window.t_end
    assert summary(chunked) == whole
    for start, end, numbers in whole:
        seconds = (stream.t[numbers] - START) / MS
        if policy.count:
            assert len(numbers) == policy.count and numbers[0] + policy.count < len(stream)
            assert (start <= seconds).all() and (seconds <= end).all()
        else:
            inside = (stream.t >= START + start * MS) & (stream.t < START + end * MS)
            np.testing.assert_array_equal(np.flatnonzero(inside), numbers)


@settings(max_examples=100)
@given(st.lists(st.integers(0, 40), min_size=1, max_size=60), st.integers(1, 20))
def test_windows_without_overlap_hold_every_event_once(gaps_ms, duration_ms):
    stream = at(*np.cumsum([*gaps_ms, 1000]))  # the last event only completes the others
    windows = by_time(duration_ms).push(stream)
    held = [n for _, _, numbers in summary(windows) for n in numbers]
    assert held == list(range(len(stream) - 1))
    assert all(a.t_end <= b.t_start for a, b in pairwise(windows))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"count": 100, "count_stride": 200}, r"window\.count_stride: 200.*leaves gaps"),
        ({"count_stride": 200}, r"window\.count_stride: 200 with windows of 0 events"),
    ],
)
def test_counts_with_gaps_are_refused(values, message):
    with pytest.raises(InputError, match=message):
        WindowPolicy(**values)


@pytest.mark.parametrize(("stride_ms", "taken_ms"), [(0.0, 50), (20.0, 20), (50.0, 50), (60.0, 50)])
def test_stride_is_at_most_the_duration(stride_ms, taken_ms):
    """So that a short duration asked for does not meet a profile's stride and leave gaps."""
    policy = WindowPolicy(duration_ms=50.0, stride_ms=stride_ms)
    assert (policy.duration_ns, policy.stride_ns) == (50_000_000, taken_ms * 1_000_000)
