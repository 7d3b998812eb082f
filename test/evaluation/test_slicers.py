"""Which events belong to an interval's window, counted by hand."""

import numpy as np
import pytest

from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.evaluation.slicers import (
    CausalSlicer,
    ClipSlicer,
    CroppedSlicer,
    IntervalSlicer,
    compared_part,
    with_lead_in,
)


def stream(times):
    """One event at each time, on row `time`."""
    t = np.asarray(times, np.int64)
    return Events(np.zeros(len(t), np.uint16), t.astype(np.uint16), t, np.ones(len(t), bool))


def cut(slicer, times, chunk=100):
    return [
        w for k in range(0, len(times), chunk) for w in slicer.push(stream(times)[k : k + chunk])
    ]


@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_interval_slicer_on_overlapping_intervals(chunk):
    intervals = [(5, 25), (10, 30), (28, 40), (98, 99)]
    windows = cut(IntervalSlicer(intervals), range(100), chunk)
    assert [(w.t_start, w.t_end) for w in windows] == intervals
    for w in windows:
        np.testing.assert_array_equal(w.events.t, np.arange(w.t_start, w.t_end))
        assert compared_part(w) is w


def test_interval_slicer_leaves_out_what_is_empty_or_not_complete():
    slicer = IntervalSlicer([(0, 10), (20, 30), (35, 50)])
    assert [w.t_start for w in slicer.push(stream([1, 15, 31, 49]))] == [0]


@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_causal_windows_end_with_the_interval_and_reach_back(chunk):
    """The first one to the stream's first event, the last one no further than its interval."""
    intervals = [(5, 15), (15, 25), (30, 40), (50, 90)]
    windows = cut(CausalSlicer(intervals, 20), range(3, 100), chunk)
    assert [(w.t_start, w.t_end) for w in windows] == [(3, 15), (5, 25), (20, 40), (50, 90)]
    assert [(w.compared.t_start, w.compared.t_end) for w in windows] == intervals
    for w in windows:
        np.testing.assert_array_equal(w.events.t, np.arange(w.t_start, w.t_end))
        np.testing.assert_array_equal(
            w.compared.events.t, np.arange(w.compared.t_start, w.compared.t_end)
        )


def test_causal_window_of_an_interval_before_the_first_event():
    (window,) = CausalSlicer([(5, 15)], 20).push(stream(range(8, 20)))
    assert (window.t_start, window.t_end) == (5, 15)
    np.testing.assert_array_equal(window.events.t, np.arange(8, 15))


def test_causal_windows_leave_out_what_is_empty_or_not_complete():
    """At 10 to 20 there is nothing, though the window has the events of 1 and 5."""
    slicer = CausalSlicer([(0, 10), (10, 20), (20, 30), (30, 50)], 30)
    assert [w.t_end for w in slicer.push(stream([1, 5, 22, 31, 49]))] == [10, 30]


def test_the_latest_part_of_a_causal_window_holds_its_interval():
    (window,) = CausalSlicer([(20, 30)], 20).push(stream(range(40)))
    assert window.since(10) is window
    for since, start in ((15, 15), (20, 20), (26, 20)):
        part = window.since(since)
        assert (part.t_start, part.t_end) == (start, 30)
        np.testing.assert_array_equal(part.events.t, np.arange(start, 30))
        assert compared_part(part) is window.compared
    assert (window.compared.t_start, len(window.compared.events)) == (20, 10)


@pytest.mark.parametrize("chunk", [1, 7, 100])
def test_sparse_clip_takes_half_of_the_missing_events_from_the_future(chunk):
    """10 of 16 events are there: 3 more from before the interval, 3 from after it."""
    (clip,) = cut(ClipSlicer([(40, 60)], 16), range(0, 100, 2), chunk)
    np.testing.assert_array_equal(clip.events.t, np.arange(34, 66, 2))
    assert (clip.t_start, clip.t_end) == (34, 65)
    part = compared_part(clip)
    assert (part.t_start, part.t_end) == (40, 60)
    np.testing.assert_array_equal(part.events.t, np.arange(40, 60, 2))


@pytest.mark.parametrize("chunk", [1, 7, 100])
def test_dense_clip_keeps_the_last_events(chunk):
    (clip,) = cut(ClipSlicer([(40, 60)], 4), range(0, 100, 2), chunk)
    np.testing.assert_array_equal(clip.events.t, [52, 54, 56, 58])
    assert (clip.t_start, clip.t_end) == (40, 60)
    assert len(compared_part(clip).events) == 10


@pytest.mark.parametrize("chunk", [1, 13, 100])
def test_clips_of_overlapping_intervals(chunk):
    intervals = [(20, 30), (25, 35), (60, 70)]
    clips = cut(ClipSlicer(intervals, 20), range(100), chunk)
    assert [(c.t_start, c.t_end) for c in clips] == [(15, 35), (20, 40), (55, 75)]
    assert [(c.compared.t_start, c.compared.t_end) for c in clips] == intervals
    assert {len(c.events) for c in clips} == {20}


def test_clip_at_the_start_has_less_of_the_past():
    (clip,) = ClipSlicer([(1, 5)], 12).push(stream(range(20)))
    np.testing.assert_array_equal(clip.events.t, np.arange(9))


def test_clip_waits_for_its_future():
    slicer = ClipSlicer([(0, 10)], 20)
    assert slicer.push(stream(range(14))) == []
    assert len(slicer.push(stream(range(14, 15)))) == 1


@pytest.mark.parametrize("rows", [None, 100])
def test_end_of_the_stream_completes_a_clip(rows):
    """The last interval has to be over, its clip does without the future then."""
    slicer = ClipSlicer([(0, 10), (5, 20)], 20)
    slicer = slicer if rows is None else CroppedSlicer(slicer, rows)
    assert slicer.push(stream(range(14))) == []
    (clip,) = slicer.finish()
    np.testing.assert_array_equal(clip.events.t, np.arange(14))
    assert slicer.finish() == []
    assert CroppedSlicer(IntervalSlicer([(0, 10)]), 100).finish() == []


def test_cropped_rows():
    (window,) = CroppedSlicer(IntervalSlicer([(0, 10)]), 7).push(stream(range(20)))
    np.testing.assert_array_equal(window.events.y, np.arange(7))
    assert (window.t_start, window.t_end) == (0, 10)


def test_cropped_clip_counts_before_the_crop_as_the_published_code_does():
    (clip,) = CroppedSlicer(ClipSlicer([(4, 10)], 10), 9).push(stream(range(20)))
    np.testing.assert_array_equal(clip.events.y, np.arange(2, 9))
    np.testing.assert_array_equal(clip.compared.events.y, np.arange(4, 9))


def test_cropped_causal_window():
    (window,) = CroppedSlicer(CausalSlicer([(5, 10)], 8), 7).push(stream(range(20)))
    np.testing.assert_array_equal(window.events.y, np.arange(2, 7))
    np.testing.assert_array_equal(window.compared.events.y, [5, 6])


def test_a_window_that_the_crop_empties_stays():
    (window,) = CroppedSlicer(IntervalSlicer([(5, 10)]), 3).push(stream(range(20)))
    assert window == Window(5, 10, window.events)
    assert len(window.events) == 0


def test_lead_in_before_the_first_interval_and_in_gaps():
    intervals = [(100, 110), (110, 120), (135, 145), (200, 210)]
    assert with_lead_in(intervals, 2) == [
        (80, 90),
        (90, 100),
        (100, 110),
        (110, 120),
        (125, 135),
        (135, 145),
        (180, 190),
        (190, 200),
        (200, 210),
    ]


def test_overlapping_intervals_need_no_lead_in():
    assert with_lead_in([(10, 20), (15, 25)], 0) == [(10, 20), (15, 25)]
