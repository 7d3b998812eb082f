"""Messages that are left out: what becomes of windows before, across and behind the gap."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from pipeline_bench import MS, PipelineBench

sys.path.append(str(Path(__file__).parents[1] / "msg_adapters"))
from encoders import evt3
from messages import event_packet

from emoflow_ros.config import load_config
from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import Events, WindowPolicy
from emoflow_ros.node.backlog import LeftOut
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_input import EventInput
from emoflow_ros.node.settings import NodeOptions, Settings
from emoflow_ros.node.tasks import Job, Task

SIZE = (64, 48)
WRAP_MS = 2**24 / 1000  # of EVT3's clock


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> PipelineBench:
    made = PipelineBench(monkeypatch)
    made.calibrate()
    return made


class Packets:
    """Numbered packets of EVT3, with an event each ms for 5 ms, into an input."""

    def __init__(self) -> None:
        self.statistics = Statistics()
        self.input = EventInput(
            "event_camera_msgs/msg/EventPacket",
            EventBudget(WindowPolicy(duration_ms=10.0), 30_000),
            timestamps=Timestamps.FUSED,
            frame_id="",
            statistics=self.statistics,
            warn=pytest.fail,
        )

    def play(self, first_ms: int, last_ms: int, ahead_ms: int = 0) -> list[Task]:
        """Push packets of sensor times from first to last; stamps are `ahead_ms` ahead."""
        tasks = []
        for ms in range(first_ms, last_ms, 5):
            t = (ms + np.arange(5)) * MS
            zeros = np.zeros(5, np.uint16)
            payload = evt3(Events(zeros, zeros, t, zeros.astype(bool))).tobytes()
            stamp = (ms + ahead_ms) * MS
            packet = event_packet(payload, "evt3", size=SIZE, stamp=stamp, seq=ms // 5)
            self.input.take(packet)
            tasks += [task for tasks in self.input.cut() for task in tasks]
        return tasks


def starts(jobs: list[Job]) -> list[int]:
    return [job.task.window.t_start // MS for job in jobs]


def test_windows_behind_a_gap_hold_only_events_behind_it(bench: PipelineBench) -> None:
    bench.play(1000, 1016)  # a window, and half of one
    bench.pipeline.skip(LeftOut(3, jump=0))
    bench.play(1018, 1034)
    before, behind = bench.supervisor.jobs()
    assert starts([before, behind]) == [1000, 1018]
    assert list(behind.task.window.events.t // MS) == [1018, 1023]
    assert behind.task.epoch == before.task.epoch
    assert behind.task.time_offset == before.task.time_offset


def test_results_of_windows_before_a_gap_still_come_and_in_order(bench: PipelineBench) -> None:
    bench.play(1000, 1011)
    bench.pipeline.skip(LeftOut(3, jump=0))
    bench.play(1200, 1211)
    for job in bench.supervisor.jobs():
        bench.supervisor.outcomes.put(bench.answer(job))
    bench.pipeline.take_outcomes()
    stamps = [m.header.stamp.nanosec // MS for m in bench.node.messages("egomotion/twist")[-2:]]
    assert stamps == [5, 205]
    counts = bench.pipeline.statistics.counts
    assert (counts["windows"], counts["windows_ok"], counts["windows_forgotten"]) == (2, 2, 0)
    assert counts["time_jumps"] == 0


def test_slices_begin_anew_behind_a_gap(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = PipelineBench(monkeypatch, twist_rate=100.0)
    bench.calibrate()
    bench.play(1000, 1056)
    bench.pipeline.skip(LeftOut(3, jump=0))
    bench.play(1070, 1126)
    assert bench.supervisor.slices.get(0.0) is None
    bench.play(1126, 1132)
    task = bench.supervisor.slices.get(0.0)
    assert task is not None
    assert (task.window.t_start, task.window.t_end) == (1070 * MS, 1130 * MS)
    assert int(task.window.events.t[0]) == 1070 * MS


def test_jump_in_time_among_what_is_left_out_starts_an_epoch(bench: PipelineBench) -> None:
    bench.play(7000, 7011)  # its window waits
    bench.pipeline.skip(LeftOut(3, jump=-6000 * MS))
    bench.play(7005, 7031)  # by the clock alone it would be no jump
    assert starts(bench.supervisor.jobs()) == [7005, 7015]
    counts = bench.pipeline.statistics.counts
    assert (counts["time_jumps"], counts["windows_forgotten"]) == (1, 1)
    line = "event time went back by 6.000 s: the estimation starts anew"
    assert bench.node.log.count(("info", line)) == 1


@pytest.mark.parametrize(
    ("first_ms", "way"), [(1000, "back by 4.010"), (16_000, "forward by 10.990")]
)
def test_jump_behind_a_gap_is_noticed(bench: PipelineBench, first_ms: int, way: str) -> None:
    bench.play(5000, 5011)
    bench.pipeline.skip(LeftOut(3, jump=0))
    bench.play(first_ms, first_ms + 16)
    assert starts(bench.supervisor.jobs()) == [first_ms]
    assert bench.pipeline.statistics.counts["time_jumps"] == 1
    assert ("info", f"event time went {way} s: the estimation starts anew") in bench.node.log


def test_nothing_is_skipped_without_a_topic(bench: PipelineBench) -> None:
    bench.pipeline.pause()
    bench.pipeline.skip(LeftOut(3, jump=-6000 * MS))
    assert bench.pipeline.statistics.counts["time_jumps"] == 0


def test_sensor_clock_that_starts_anew_in_a_gap_is_noticed() -> None:
    """The stamps go on, but the sensor's time and the packets' numbers are back at their start."""
    packets = Packets()
    packets.play(8000, 8030, ahead_ms=50_000)
    packets.input.skip(LeftOut(3, jump=0))
    tasks = packets.play(500, 530, ahead_ms=57_550)
    assert {task.epoch for task in tasks} == {1}
    assert [task.stamp // MS for task in tasks] == [58_055, 58_065]


def test_packets_that_are_left_out_are_no_gap_in_their_numbers() -> None:
    packets = Packets()
    packets.play(1000, 1030)
    packets.input.skip(LeftOut(14, jump=0))
    packets.play(1100, 1130)
    assert packets.statistics.counts["seq_gaps"] == 0
    packets.play(1145, 1150)  # three packets were lost
    assert packets.statistics.counts["seq_gaps"] == 3


def test_packets_that_are_lost_beside_those_that_are_left_out_are_a_gap() -> None:
    packets = Packets()
    packets.play(1000, 1030)
    packets.input.skip(LeftOut(10, jump=0))
    packets.play(1100, 1130)  # 14 are missing
    assert packets.statistics.counts["seq_gaps"] == 4


def test_wraps_of_the_sensor_clock_are_counted_on_over_a_gap() -> None:
    packets = Packets()
    wrap = round(WRAP_MS)
    packets.play(wrap - 52, wrap + 33, ahead_ms=50_000)
    packets.input.skip(LeftOut(34, jump=0))
    tasks = packets.play(wrap + 203, wrap + 233, ahead_ms=50_000)
    assert [task.stamp // MS for task in tasks] == [wrap + 50_208, wrap + 50_218]
    assert packets.input.epoch == 0


def test_what_may_wait_is_a_window_and_the_strides_of_those_that_may_wait() -> None:
    settings = Settings(NodeOptions(), load_config())
    assert settings.backlog_ns == 202_500_000
    assert settings.changed({"input.queue_windows": 100}).backlog_ns == 6885 * MS
    short = settings.changed({"window.duration_ms": 10.0})
    assert short.backlog_ns == 70 * MS  # a slice of 60 ms is longer
    assert short.changed({"output.twist_rate": 0.0}).backlog_ns == 20 * MS
    assert short.changed({"window.count": 20_000}).backlog_ns == 2000 * MS  # one, and one waits
