import struct

import pytest
from input_bench import CAMERA, MS, SMALL, Bench

from emoflow_ros.core.stream.clock import Timestamps
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import WindowPolicy
from emoflow_ros.node.event_input import EventInput


def event_packet(encoding: str, payload: bytes) -> bytes:
    """Serialised EventPacket of a sensor of CAMERA's size, with an empty frame."""
    name = encoding.encode() + b"\0"
    head = struct.pack("<iII4xIIQQ", 1, 0, 1, CAMERA.height, CAMERA.width, 0, 0)
    body = head + struct.pack("<I", len(name)) + name + b"\0"
    body += bytes(-len(body) % 4)
    return b"\x00\x01\x00\x00" + body + struct.pack("<I", len(payload)) + payload


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_windows_become_tasks_with_the_frame_of_the_messages(bench: Bench) -> None:
    assert bench.push(1000, 1004, 1008) == []
    [task] = bench.push(1012)
    assert (task.window.t_start, task.window.t_end) == (1000 * MS, 1010 * MS)
    assert len(task.window.events) == 3
    assert task.frame_id == "davis_left_optical"
    assert task.epoch == 0
    assert bench.statistics.counts["events"] == 4
    assert bench.statistics.counts["messages"] == 2


def test_events_of_a_part_stand_for_the_others_and_windows_go_on(bench: Bench) -> None:
    bench.push(1000, 1001)
    bench.push(1002, 1003, 1004, 1005, part=4)
    [task] = bench.push(1010)
    events = task.window.events
    assert (events.t // MS).tolist() == [1000, 1001, 1002]
    assert events.stands_for is not None
    assert events.stands_for.tolist() == [1, 1, 4]
    assert events.came == 6
    assert bench.statistics.counts["events"] == 4


def test_given_frame_counts_before_that_of_the_messages() -> None:
    bench = Bench(frame_id="mine")
    [task] = bench.push(1000, 1012)
    assert task.frame_id == "mine"


def test_event_time_close_to_the_stamps_is_ros_time(bench: Bench) -> None:
    [task] = bench.push(1000, 1012, stamp_ms=1020)
    assert task.time_offset == 0


def test_sensor_time_is_mapped_by_the_first_stamp(bench: Bench) -> None:
    [task] = bench.push(1000, 1012, stamp_ms=50_000)
    assert task.time_offset == 49_000 * MS
    [task] = bench.push(1021, stamp_ms=50_025)  # a delay of 4 ms more
    assert task.time_offset == 49_000 * MS


def test_event_times_on_ros_time_stay_with_the_stamps_of_last_events(
    bench: Bench,
) -> None:
    tasks = []
    for second in range(120):
        start, length = 1000 * (second + 1), 5 + 30 * (second % 3)
        tasks += bench.push(start, start + length, stamp_ms=start + length)
    assert {task.time_offset for task in tasks} == {0}
    assert len(tasks) > 120


def test_sensor_time_is_kept_on_request() -> None:
    bench = Bench(timestamps=Timestamps.SENSOR)
    [task] = bench.push(1000, 1012, stamp_ms=50_000)
    assert task.time_offset == 0


def test_jump_back_starts_an_epoch_without_the_unfinished_window(bench: Bench) -> None:
    bench.push(5000, 5004)
    assert bench.push(1000, 1004) == []
    [task] = bench.push(1012)
    assert task.epoch == 1
    assert len(task.window.events) == 2
    assert bench.statistics.counts["time_jumps"] == 1
    assert bench.warnings == []


def test_small_step_back_leaves_the_early_events_out(bench: Bench) -> None:
    bench.push(1000, 1004)
    assert bench.push(1003, 1005) == []
    [task] = bench.push(1012)
    assert (task.window.events.t // MS).tolist() == [1000, 1004, 1005]
    assert bench.input.epoch == 0
    assert bench.statistics.counts["events_unordered"] == 1
    assert bench.warnings == ["1 events out of order are left out"]


@pytest.mark.parametrize("wrong_ms", [4, 900, 1002.9, 1500, 1_700_000_000_000])
def test_single_event_out_of_order_within_a_message_is_left_out(
    bench: Bench, wrong_ms: float
) -> None:
    assert bench.push(1000, 1003, wrong_ms, 1004, 1005) == []
    [task] = bench.push(1012)
    assert (task.window.events.t // MS).tolist() == [1000, 1003, 1004, 1005]
    assert bench.input.epoch == 0
    assert bench.statistics.counts["events_unordered"] == 1
    assert bench.statistics.counts["unordered_messages"] == 0
    assert bench.statistics.counts["events"] == 5


@pytest.mark.parametrize("wrong_ms", [4, 20_000, 1_700_000_000_000])
def test_first_event_of_a_message_out_of_order_is_left_out(bench: Bench, wrong_ms: float) -> None:
    bench.push(1000, 1003)
    assert bench.push(wrong_ms, 1004, 1005, stamp_ms=1004) == []
    [task] = bench.push(1012)
    assert (task.window.events.t // MS).tolist() == [1000, 1003, 1004, 1005]
    assert bench.input.epoch == 0
    assert bench.statistics.counts["events_unordered"] == 1


@pytest.mark.parametrize("place", [0, 1, 3])
@pytest.mark.parametrize("early_ms", [4, 1002.9])
def test_event_out_of_order_behind_a_wrong_stamp_is_left_out_alone(
    bench: Bench, place: int, early_ms: float
) -> None:
    bench.push(1000, 1003)
    times: list[float] = [1004, 1005, 1006]
    times.insert(place, early_ms)
    bench.push(*times, stamp_ms=500_000)
    [task] = bench.push(1012)
    assert (task.window.events.t // MS).tolist() == [1000, 1003, 1004, 1005, 1006]
    assert bench.input.epoch == 0
    counts = bench.statistics.counts
    assert (counts["wrong_stamps"], counts["events_unordered"]) == (1, 1)
    assert counts["unordered_messages"] == 0


def test_whole_message_that_is_far_too_early_starts_an_epoch(bench: Bench) -> None:
    """Only its events: the stamps go on."""
    bench.push(5000, 5004)
    bench.push(1000, 1004, stamp_ms=5008)
    [task] = bench.push(1012, stamp_ms=5016)
    assert (task.epoch, len(task.window.events)) == (1, 2)
    assert bench.input.jump == "event time went back by 4.000 s"


def test_time_that_goes_back_for_good_within_a_message_starts_an_epoch(bench: Bench) -> None:
    """Half of the message is of the old time, and the stamps go on."""
    bench.push(5000, 5004)
    bench.push(*range(5005, 5155, 5), *range(1000, 1150, 5), stamp_ms=5005)
    assert bench.input.epoch == 1
    assert bench.statistics.counts["time_jumps"] == 1
    assert bench.input.jump == "event time went back by 4.150 s"


@pytest.mark.parametrize("late_ms", [11_000, 1_700_000_000_000])
def test_jump_within_a_message_leaves_it_out(bench: Bench, late_ms: int) -> None:
    bench.push(1000, 1004)
    assert bench.push(1006, 1006 + late_ms, 1007 + late_ms) == []
    assert "event times jump within it" in bench.warnings[0]
    [task] = bench.push(1012)
    assert (len(task.window.events), bench.input.epoch) == (2, 0)


def test_malformed_message_is_counted_and_said(bench: Bench) -> None:
    bench.input.take(b"\x00\x01\x00\x00\x07")
    assert bench.input.cut() == []
    assert bench.statistics.counts["malformed_messages"] == 1
    assert "malformed" in bench.warnings[0]


def test_new_policy_cuts_from_the_next_event_on(bench: Bench) -> None:
    bench.push(1000, 1004)
    bench.input.set_budget(EventBudget(WindowPolicy(duration_ms=2.0), 30_000))
    [task] = bench.push(1005, 1008)
    assert (task.window.t_start, task.window.t_end) == (1005 * MS, 1007 * MS)


def test_same_policy_does_not_lose_the_unfinished_window(bench: Bench) -> None:
    bench.push(1000, 1004)
    bench.input.set_budget(EventBudget(WindowPolicy(duration_ms=10.0), 10))  # 1 per ms
    [task] = bench.push(1006, 1006.1, 1006.2, 1006.3, 1012)
    assert len(task.window.events) == 3
    assert bench.statistics.counts["events_thinned"] == 3


def test_sizes_do_not_mix_before_a_calibration(bench: Bench) -> None:
    bench.input.camera = None
    bench.push(1000, 1004)
    assert bench.push(1005, 1006, camera=SMALL) == []
    [task] = bench.push(1012)
    assert len(task.window.events) == 2
    assert bench.input.size == (64, 48)
    assert bench.statistics.counts["wrong_size_messages"] == 1
    assert bench.statistics.counts["events"] == 3
    assert bench.warnings == [
        "events of a 32x24 sensor are left out: those before were of a 64x48 one; "
        "publish one sensor's events on a topic"
    ]


def test_calibration_of_another_size_forgets_what_was_heard_before_it(bench: Bench) -> None:
    bench.input.camera = None
    bench.push(1000, 1004, camera=SMALL)
    bench.input.camera = CAMERA
    assert bench.push(1005, 1006) == []
    [task] = bench.push(1016)
    assert (task.window.t_start, len(task.window.events)) == (1005 * MS, 2)
    assert bench.warnings == []


def test_calibration_of_the_size_that_was_heard_keeps_the_window(bench: Bench) -> None:
    bench.input.camera = None
    bench.push(1000, 1004)
    bench.input.camera = CAMERA
    [task] = bench.push(1012)
    assert (task.window.t_start, len(task.window.events)) == (1000 * MS, 2)


def test_recording_of_another_sensor_is_heard_after_a_jump(bench: Bench) -> None:
    bench.input.camera = None
    bench.push(5000, 5004)
    bench.push(1000, 1004, camera=SMALL)
    [task] = bench.push(1012, camera=SMALL)
    assert (bench.input.size, len(task.window.events)) == ((32, 24), 2)
    assert bench.warnings == []


def test_encoding_is_known_from_the_first_packet(bench: Bench) -> None:
    bench.push(1000)
    assert bench.input.encoding == ""  # EventArray has one only
    packets = EventInput(
        "event_camera_msgs/msg/EventPacket",
        EventBudget(WindowPolicy(duration_ms=10.0), 30_000),
        timestamps=Timestamps.FUSED,
        frame_id="",
        statistics=bench.statistics,
        warn=bench.warnings.append,
    )
    assert packets.encoding == ""
    packets.take(event_packet("mono", bytes(8)))
    assert packets.encoding == "mono"
