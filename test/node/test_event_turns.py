"""Messages that come in one turn and are cut into windows together."""

from typing import Any

import pytest
from input_bench import MS, Bench

from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import WindowPolicy
from emoflow_ros.node import event_input


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_messages_that_are_cut_together_make_the_same_windows(monkeypatch: Any) -> None:
    """Two windows and the newest slice, whether messages are cut one by one or at once."""
    slices = EventBudget(WindowPolicy(duration_ms=4.0, stride_ms=2.0), 30_000)
    for most in (1, 50_000):
        monkeypatch.setattr(event_input, "_MOST_TAKEN", most)
        bench = Bench(slices=slices)
        for t in range(1000, 1024, 2):
            bench.take(t, t + 1, part=2 if t % 4 else 1)
        bench.input.take(b"malformed")
        tasks = bench.cut()
        windows = [task.window for task in tasks if not task.is_slice]
        assert [w.t_start // MS for w in windows] == [1000, 1010]
        assert [w.events.came for w in windows] == [10, 10]
        newest = [task.window for task in tasks if task.is_slice][-1]
        assert (newest.t_end // MS, newest.events.came) == (1022, 4)
        assert bench.statistics.counts["windows"] == 2
        assert bench.input.cut() == []


def test_stamps_do_not_depend_on_how_many_messages_come_together() -> None:
    """Each window's offset is that of when it was complete, though the delay of stamps changes."""
    offsets = []
    for together in (1, 8, 40):
        bench = Bench(timestamps=Timestamps.HEADER)
        tasks = []
        for k in range(40):
            t = 1000 + 2 * k
            bench.take(t, t + 1, stamp_ms=50_000 + t + (15 if 8 <= k < 20 else 3))
            if k % together == together - 1:
                tasks += bench.cut()
        offsets.append([task.time_offset for task in tasks])
    assert len(offsets[0]) == 7
    assert offsets[0] == offsets[1] == offsets[2]
    assert len(set(offsets[0])) > 1


def test_windows_of_several_messages_stand_apart(bench: Bench) -> None:
    """Those that one message completes stand together."""
    for t in (1000, 1004, 1012, 1015, 1021, 1045):
        bench.take(t)
    starts = [[task.window.t_start // MS for task in tasks] for tasks in bench.input.cut()]
    assert starts == [[1000], [1010], [1020]]
    bench.take(1046)
    bench.take(1050)
    bench.take(1060)
    starts = [[task.window.t_start // MS for task in tasks] for tasks in bench.input.cut()]
    assert starts == [[1040], [1050]]


def test_jump_among_messages_that_are_cut_together(bench: Bench) -> None:
    """The window before it is forgotten; the one behind it holds no event from before."""
    for t in (5000, 5004, 5012, 1000, 1004, 1012):
        bench.take(t)
    [task] = bench.cut()
    assert (task.epoch, task.window.t_start, len(task.window.events)) == (1, 1000 * MS, 2)
    assert task.time_offset == 0
    assert bench.statistics.counts["windows"] == 2
    assert bench.statistics.counts["windows_forgotten"] == 1
