"""Jumps of time at the node's input: loops, seeks, pauses, clocks that start at 0 or wrap."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parents[1] / "msg_adapters"))
from encoders import evt3
from messages import event_packet

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import Events, WindowPolicy
from emoflow_ros.node.backlog import LeftOut
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.event_input import EventInput
from emoflow_ros.node.tasks import Task
from emoflow_ros.simulation.messages import EVENT_ARRAY, MessageEncoder

MS = 1_000_000
S = 1000  # in ms
CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)
PACKET = "event_camera_msgs/msg/EventPacket"


class Stream:
    """A sensor's messages of 5 ms each into an input with windows of 10 ms.

    Args:
        ros_type: of the messages; packets carry evt3, whose time wraps after 16.777216 s.
        timestamps: which time the tasks are stamped with.
    """

    def __init__(self, ros_type: str, timestamps: Timestamps = Timestamps.FUSED) -> None:
        self.statistics = Statistics()
        self.warnings: list[str] = []
        self.input = EventInput(
            ros_type,
            EventBudget(WindowPolicy(duration_ms=10.0), 30_000),
            timestamps=timestamps,
            frame_id="",
            statistics=self.statistics,
            warn=self.warnings.append,
        )
        self._packets = ros_type == PACKET
        self._encoder = MessageEncoder(ros1=False)

    def play(self, first_ms: int, last_ms: int, ahead_ms: float = 0) -> list[Task]:
        """Push messages of sensor times from first to last; stamps are `ahead_ms` ahead."""
        tasks = []
        for t_ms in range(first_ms, last_ms, 5):
            t = (t_ms + np.arange(5)) * MS
            zeros = np.zeros(5, np.uint16)
            events = Events(zeros, zeros, t, zeros.astype(bool))
            self.input.take(self._message(events, round((t_ms + ahead_ms) * MS)))
            tasks += [task for tasks in self.input.cut() for task in tasks]
        return tasks

    def _message(self, events: Events, stamp: int) -> bytes:
        if self._packets:
            size = (CAMERA.width, CAMERA.height)
            return event_packet(evt3(events).tobytes(), "evt3", size=size, stamp=stamp, seq=0)
        return self._encoder.events(stamp, CAMERA, events)


@pytest.fixture(params=[EVENT_ARRAY, PACKET])
def stream(request: pytest.FixtureRequest) -> Stream:
    return Stream(request.param)


def stamps_ms(tasks: list[Task]) -> list[int]:
    return [task.stamp // MS for task in tasks]


def test_clock_may_start_at_zero(stream: Stream) -> None:
    assert stamps_ms(stream.play(0, 35)) == [5, 15, 25]
    assert stream.input.epoch == 0


@pytest.mark.parametrize("times", [1, 3])
def test_every_round_of_a_loop_gives_the_same_windows(stream: Stream, times: int) -> None:
    first = stream.play(7000, 7225)
    assert len(first) == 22
    for epoch in range(1, times + 1):
        again = stream.play(7000, 7225)
        assert stamps_ms(again) == stamps_ms(first)
        assert {task.epoch for task in again} == {epoch}
        assert stream.input.jump == "event time went back by 0.220 s"
    assert stream.statistics.counts["time_jumps"] == times
    assert stream.warnings == []


def test_seek_back_and_forward_start_epochs(stream: Stream) -> None:
    stream.play(15_000, 15_030)
    back = stream.play(2000, 2030)
    assert (stamps_ms(back), {task.epoch for task in back}) == ([2005, 2015], {1})
    forward = stream.play(16_000, 16_030)
    assert (stamps_ms(forward), {task.epoch for task in forward}) == ([16_005, 16_015], {2})
    assert stream.input.jump == "event time went forward by 13.975 s"


def test_unfinished_window_does_not_reach_over_a_jump(stream: Stream) -> None:
    stream.play(5000, 5010)
    [task] = stream.play(1000, 1015)
    assert len(task.window.events) == 10


def test_pause_is_no_jump(stream: Stream) -> None:
    stream.play(1000, 1015)
    assert stamps_ms(stream.play(1015, 1030)) == [1015]
    assert stamps_ms(stream.play(4030, 4060)) == [1025, 4035, 4045]  # silence of 3 s
    assert stream.statistics.counts["time_jumps"] == 0


def test_wrap_of_the_sensor_clock_is_no_jump() -> None:
    """The sensor counts on while its 24 bits start again."""
    stream = Stream(PACKET)
    wrap = 2**24 // 1000
    tasks = stream.play(wrap - 52, wrap + 53)
    assert stamps_ms(tasks) == [wrap - 47 + 10 * k for k in range(10)]
    assert stream.input.epoch == 0
    assert stream.statistics.counts["time_jumps"] == 0


def test_wrap_that_nobody_saw_does_not_shift_the_stamps() -> None:
    """After 20 s of silence the sensor's time has advanced by 20 s less a wrap."""
    stream = Stream(PACKET)
    stream.play(1000, 1030, ahead_ms=50 * S)
    tasks = stream.play(21_000, 21_030, ahead_ms=50 * S)
    assert stamps_ms(tasks) == [71_005, 71_015]
    assert stream.input.epoch == 1


def test_host_clock_that_is_set_back_starts_an_epoch() -> None:
    stream = Stream(EVENT_ARRAY)
    assert stamps_ms(stream.play(1000, 1030, ahead_ms=50 * S)) == [51_005, 51_015]
    assert stamps_ms(stream.play(1030, 1060, ahead_ms=40 * S)) == [41_035, 41_045]
    assert stream.input.jump == "event time went back by 9.995 s"


def test_jitter_of_the_stamps_is_no_jump() -> None:
    stream = Stream(EVENT_ARRAY)
    for t, delay in ((1000, 50_080), (1005, 50_001), (1010, 50_090), (1015, 50_002)):
        stream.play(t, t + 5, ahead_ms=delay)
    assert stream.input.epoch == 0


@pytest.mark.parametrize("timestamps", list(Timestamps))
def test_stamps_increase_within_every_epoch(timestamps: Timestamps) -> None:
    stream = Stream(EVENT_ARRAY, timestamps)
    rng = np.random.default_rng(4)
    tasks: list[Task] = []
    for start in (9000, 2000, 30_000, 0):
        for t in range(start, start + 300, 5):
            tasks += stream.play(t, t + 5, ahead_ms=7000 + int(rng.integers(0, 40)))
    for epoch in range(4):
        stamps = [task.stamp for task in tasks if task.epoch == epoch]
        assert len(stamps) >= 28
        assert (np.diff(stamps) > 0).all()


def test_drift_of_the_sensor_clock_is_reported() -> None:
    """Stamps that advance by 10 ms + 1 us per 10 ms of sensor time: 100 ppm."""
    stream = Stream(EVENT_ARRAY)
    for t in range(0, 20_000, 50):
        stream.play(t, t + 5, ahead_ms=5000 + t * 1e-4)
    assert stream.statistics.clock_drift_ppm == pytest.approx(100, abs=1)


def test_sensor_clock_that_was_set_from_the_host_once_is_followed() -> None:
    """100 ppm for 60 s are 6 ms; the constant delay of 4 ms is none of the clock's."""
    stream = Stream(EVENT_ARRAY)
    tasks: list[Task] = []
    for t in range(0, 60_000, 50):
        tasks += stream.play(t, t + 5, ahead_ms=4 + t * 1e-4)
    assert tasks[0].time_offset == pytest.approx(0, abs=0.01 * MS)
    assert tasks[-1].time_offset == pytest.approx(6 * MS, abs=0.6 * MS)
    assert stream.statistics.clock_drift_ppm == pytest.approx(100, abs=1)


@pytest.mark.parametrize("wrong_ms", [-50 * S, 500 * S])
def test_one_wrong_stamp_is_no_jump_and_costs_no_event(stream: Stream, wrong_ms: int) -> None:
    tasks = stream.play(60 * S, 60 * S + 20)
    tasks += stream.play(60 * S + 20, 60 * S + 25, ahead_ms=wrong_ms)
    tasks += stream.play(60 * S + 25, 60 * S + 50)
    assert stamps_ms(tasks) == [60_005, 60_015, 60_025, 60_035]
    assert [len(task.window.events) for task in tasks] == [10] * 4
    assert stream.input.epoch == 0
    counts = stream.statistics.counts
    assert (counts["time_jumps"], counts["wrong_stamps"]) == (0, 1)
    assert stream.warnings == ["the stamp of a message is not used: it is far from those around it"]


def test_two_wrong_stamps_that_disagree_are_no_jump(stream: Stream) -> None:
    tasks = stream.play(60 * S, 60 * S + 20)
    for k, wrong_ms in enumerate((-50 * S, 500 * S)):
        t = 60 * S + 20 + 5 * k
        tasks += stream.play(t, t + 5, ahead_ms=wrong_ms)
    tasks += stream.play(60 * S + 30, 60 * S + 50)
    assert stamps_ms(tasks) == [60_005, 60_015, 60_025, 60_035]
    assert stream.statistics.counts["wrong_stamps"] == 2
    assert stream.input.epoch == 0


def test_late_message_of_before_a_jump_does_not_start_an_epoch(stream: Stream) -> None:
    stream.play(60 * S, 60 * S + 20)
    stream.play(5 * S, 5 * S + 20)
    stream.play(60 * S + 20, 60 * S + 25)  # of the round before
    stream.play(5 * S + 20, 5 * S + 50)
    assert stream.statistics.counts["time_jumps"] == 1
    assert stream.input.epoch == 1


def test_message_that_waits_for_the_next_one_is_counted_when_both_are_left_out(
    stream: Stream,
) -> None:
    stream.play(60 * S, 60 * S + 20)
    stream.play(5 * S, 5 * S + 5)
    stream.input.skip(LeftOut(3, -55 * S * MS))
    assert stream.statistics.counts["messages_skipped"] == 1
    assert stamps_ms(stream.play(5 * S + 20, 5 * S + 45)) == [5025, 5035]
    assert stream.input.epoch == 1


def test_malformed_message_with_a_stamp_by_chance_is_counted_at_once(stream: Stream) -> None:
    stream.play(60 * S, 60 * S + 20)
    stream.input.take(b"\x00\x01\x00\x00" + bytes(range(40)))
    assert stream.statistics.counts["malformed_messages"] == 1
    assert stamps_ms(stream.play(60 * S + 20, 60 * S + 45)) == [60_015, 60_025, 60_035]
    assert stream.input.epoch == 0
