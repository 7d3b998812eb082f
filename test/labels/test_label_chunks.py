"""Chunks of time: together they hold the windows of a run without chunks, each of them once."""

import numpy as np
import pytest

from emoflow_ros.core.types.events import Events, WindowPolicy, WindowSlicer
from emoflow_ros.labels.label_chunks import Chunk, chunk_windows
from emoflow_ros.labels.label_run import event_span, plan_chunks
from emoflow_ros.readers import open_recording

MS = 1_000_000
START = 1_500_000_000_123_456_789


class Stream:
    """A recording of given event times that counts what is read of it."""

    def __init__(self, t, size=50):
        self._t, self._size = t, size
        self.read = 0

    def event_chunks(self, since=None):
        t = self._t if since is None else self._t[np.searchsorted(self._t, since) :]
        for k in range(0, len(t), self._size):
            part = t[k : k + self._size]
            self.read += len(part)
            zeros = np.zeros(len(part), np.uint16)
            yield Events(zeros, zeros, part, zeros.astype(bool))


def identify(window):
    return window.t_start, window.t_end, len(window.events), int(window.events.t[0])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("stride_ms", [0.0, 7.0, 10.0, 23.4])
@pytest.mark.parametrize(("chunk_s", "margin_s"), [(0.0, 0.0), (0.05, 0.03), (0.31, 1.0), (9, 0.1)])
def test_same_windows_as_one_run(seed, stride_ms, chunk_s, margin_s):
    """Random events with silences longer than windows and chunks, from an odd first time on."""
    rng = np.random.default_rng(seed)
    gaps = rng.exponential(1.5 * MS, 700) + (rng.random(700) < 0.01) * rng.exponential(200 * MS)
    t = START + np.cumsum(gaps).astype(np.int64)
    policy = WindowPolicy(duration_ms=23.4, stride_ms=stride_ms)
    slicer = WindowSlicer(policy)
    expected = [identify(w) for e in Stream(t).event_chunks() for w in slicer.push(e)]
    chunks = plan_chunks((int(t[0]), int(t[-1])), policy, chunk_s, margin_s)
    found = []
    for chunk in chunks:
        windows = [identify(w) for w in chunk_windows(Stream(t), chunk.intervals(policy))]
        warm_up = [w for w in windows if w[0] < chunk.start]
        assert warm_up == [w for w in expected if w[0] < chunk.start][len(found) - len(warm_up) :]
        found += windows[len(warm_up) :]
    assert found == expected


def test_plan_by_hand():
    """1 s in windows of 90 ms every 30 ms: the last of 31 starts at 900 ms."""
    policy = WindowPolicy(duration_ms=90.0, stride_ms=30.0)
    chunks = plan_chunks((5, 5 + 1000 * MS), policy, chunk_s=0.3, margin_s=0.1)
    assert chunks == [
        Chunk(0, 5, 10, 0),
        Chunk(1, 5 + 300 * MS, 10, 4),
        Chunk(2, 5 + 600 * MS, 10, 4),
        Chunk(3, 5 + 900 * MS, 1, 4),
    ]
    assert chunks[3].intervals(policy)[0] == (5 + 780 * MS, 5 + 870 * MS)
    assert chunks[3].intervals(policy)[-1] == (5 + 900 * MS, 5 + 990 * MS)
    one_ns_less = plan_chunks((5, 5 + 990 * MS - 1), policy, 0.3, 0.1)
    assert sum(chunk.windows for chunk in one_ns_less) == 30
    assert plan_chunks((5, 5 + 90 * MS - 1), policy, 0.3, 0.1) == []


def test_no_more_is_read_than_the_chunk():
    stream = Stream(START + np.arange(100_000, dtype=np.int64) * MS)
    policy = WindowPolicy(duration_ms=100.0)
    chunk = plan_chunks((START, START + 99_999 * MS), policy, 10.0, 1.0)[3]
    assert len(list(chunk_windows(stream, chunk.intervals(policy)))) == 110
    assert 11_000 <= stream.read <= 11_100


@pytest.mark.parametrize("log_s", [1, 3, 60])
def test_span_is_that_of_the_events(tmp_path, make_events, write_event_bag, log_s):
    """Whether the bag's messages were logged faster or more slowly than their events."""
    events = make_events(3000)
    logged = [10**9 + k * log_s * 10**7 for k in range(100)]
    batches = [events[30 * k : 30 * k + 30] for k in range(100)]
    path = write_event_bag(tmp_path / "a.bag", batches, log_times=logged)
    with open_recording(path) as recording:
        assert recording.duration == pytest.approx(log_s, rel=0.02)
        assert event_span(recording) == (int(events.t[0]), int(events.t[-1]))
