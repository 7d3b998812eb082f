"""How many events windows hold, by whether they find the worker busy."""

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_clock import Clock
from pipeline_bench import PipelineBench

from emoflow_ros.node.event_share import EventShare
from emoflow_ros.node.reports import Level


class Windows:
    """Windows, 100 ms one after another."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.share = EventShare(self.clock)

    def come(self, count: int, *, is_busy: bool) -> list[int]:
        """Return each part that windows were to hold."""
        parts = [self.share.part]
        for _ in range(count):
            self.clock.now = round(self.clock.now + 0.1, 1)
            before = self.share.part
            assert self.share.note(is_busy=is_busy) == (self.share.part != before)
            parts.append(self.share.part)
        return list(dict.fromkeys(parts))


def test_two_windows_in_a_row_that_find_the_worker_busy_halve_the_events() -> None:
    windows = Windows()
    for _ in range(5):
        assert windows.come(1, is_busy=True) == [1]
        assert windows.come(1, is_busy=False) == [1]
    assert windows.come(2, is_busy=True) == [1, 2]
    assert windows.come(2, is_busy=True) == [2, 4]
    assert windows.come(100, is_busy=True) == [4]


def test_events_come_back_after_3_s_in_which_the_worker_kept_up() -> None:
    windows = Windows()
    windows.come(4, is_busy=True)
    assert windows.come(30, is_busy=False) == [4]
    assert windows.come(1, is_busy=False) == [4, 2]
    assert windows.come(20, is_busy=False) == [2]
    assert windows.come(1, is_busy=True) == [2]
    assert windows.come(30, is_busy=False) == [2]
    assert windows.come(2, is_busy=False) == [2, 1]


def test_windows_hold_fewer_events_before_any_is_dropped_and_the_diagnostics_say_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench = PipelineBench(monkeypatch)
    bench.calibrate()
    bench.pipeline.statistics.clear_problem("input")
    bench.play(1000, 1011)
    [job] = bench.supervisor.jobs()
    assert job.part == 1
    assert bench.pipeline.report().values["events_share"] == "1"
    bench.supervisor.busy_s = 0.01
    bench.play(1015, 1031)
    assert [job.part for job in bench.supervisor.jobs()] == [1, 2]
    assert bench.said == []  # no window is dropped
    report = bench.pipeline.report()
    assert report.level is Level.OK
    assert report.message == (
        "running; windows hold at most 1/2 of the usual events, as they find the worker busy"
    )
    assert report.values["events_share"] == "0.5"
    bench.play(1035, 1061)  # more than may wait
    assert bench.pipeline.report().message.endswith(
        "; windows hold at most 1/4 of the usual events, as they find the worker busy"
    )
    bench.supervisor.busy_s = 0.0
    usual = bench.settings.budget
    assert bench.pipeline._input is not None
    budget = bench.pipeline._input._slicer.budget
    assert (budget.policy, budget.max_events) == (usual.policy, usual.max_events // 4)
