"""Readings beside windows in the node, and each fault of an IMU's messages."""

import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_clock import Clock

from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.core.types.gyro import GyroReadings, GyroState
from emoflow_ros.node.imu_input import ImuInput, MountingError, ReadingBuffer
from emoflow_ros.node.tasks import Task
from emoflow_ros.simulation.messages import ImuSample, MessageEncoder

MS = 1_000_000
S = 1_000_000_000
START = 1_500_000_000 * S
ENCODER = MessageEncoder(ros1=False)
CONFIG = GyroConfig(use="auto")


class Bench:
    """Messages every millisecond, windows of 45 ms; a task is received as its window ends."""

    def __init__(self, config: GyroConfig = CONFIG, offset: int = 0) -> None:
        self.clock = Clock()
        self.offset = offset
        self.input = ImuInput(config, lambda source, target: config.matrix(), self.clock)
        self.rng = np.random.default_rng(0)
        self.sent: list[tuple[int, np.ndarray]] = []

    def send(self, first_ms: int, last_ms: int, change=lambda t, w: (t, w)) -> None:
        for ms in range(first_ms, last_ms):
            t, w = change(START + ms * MS, np.array([0.1, -0.2, 0.3]) + self.rng.normal(0, 1e-3, 3))
            self.clock.now += 1e-3
            self.sent.append((t, w))
            self.input.take(ENCODER.imu(t, ImuSample(w, np.zeros(3))))

    def task(self, first_ms: int, last_ms: int) -> Task:
        start, end = (START + ms * MS - self.offset for ms in (first_ms, last_ms))
        window = Window(start, end, Events.empty())
        return Task(window, 0, self.offset, "camera", self.clock.now)

    def window(self, first_ms: int, last_ms: int) -> Window:
        self.input.hold([self.task(first_ms, last_ms)])
        [task] = self.input.ready()
        return task.window


def judged(bench: Bench, window: Window) -> str:
    gyro = Gyro(CONFIG)
    gyro.measure(window.t_start, window.t_end, window.gyro)
    return str(gyro.status)


def test_a_window_gets_the_readings_that_it_would_get_offline() -> None:
    config = GyroConfig(use="auto", rotation="10,-20,90", time_offset_ms=3.0)
    bench = Bench(config)
    bench.send(0, 120)
    window = bench.window(20, 65)
    t, w = (np.array(part) for part in zip(*bench.sent, strict=True))
    offline = GyroReadings.mounted(t, w, config.matrix(), config.time_offset_ns)
    expected = offline.covering(window.t_start, window.t_end)
    np.testing.assert_array_equal(window.gyro.t, expected.t)
    np.testing.assert_array_equal(window.gyro.w, expected.w)
    assert len(expected) == 46


@pytest.mark.parametrize("offset", [1_400_000_000 * S, -7 * S])
def test_stamps_are_mapped_to_a_sensors_own_time(offset: int) -> None:
    bench = Bench(offset=offset)
    bench.send(0, 100)
    window = bench.window(20, 65)
    assert window.gyro.t[0] == window.t_start
    assert window.gyro.t[-1] == window.t_end


def test_a_small_offset_of_the_clocks_is_not_that_of_the_imu() -> None:
    """The events' times are ROS times; that messages come a little later says nothing."""
    bench = Bench(offset=4 * MS)
    bench.send(0, 100)
    window = bench.window(20, 65)
    assert window.gyro.t[0] == window.t_start


def test_a_window_waits_for_its_last_readings_and_those_after_it_too() -> None:
    bench = Bench()
    bench.send(0, 60)
    bench.input.hold([bench.task(20, 62), bench.task(15, 55)])
    assert bench.input.ready() == []
    assert bench.input.is_waited_for
    bench.send(60, 63)
    first, second = bench.input.ready()
    assert (first.window.t_end, first.window.gyro.t[-1]) == (START + 62 * MS,) * 2
    assert second.window.t_start == START + 15 * MS
    assert not bench.input.is_waited_for


def test_a_window_waits_no_longer_than_eight_milliseconds() -> None:
    bench = Bench()
    bench.send(0, 60)
    bench.input.hold([bench.task(20, 80)])
    bench.clock.now += 0.0079
    assert bench.input.ready() == []
    bench.clock.now += 0.0002
    [task] = bench.input.ready()
    assert task.window.gyro.t[-1] == START + 59 * MS


def test_a_silent_gyro_is_not_waited_for() -> None:
    bench = Bench()
    bench.send(0, 60)
    window = bench.window(300, 345)
    assert len(window.gyro) == 0
    assert judged(bench, window) == "rejected (no readings)"
    bench.clock.now += 0.6
    assert bench.input.problem("/imu") == "no message on /imu for 0.6 s: check the driver"


def test_without_an_imu_windows_go_at_once_and_as_they_are() -> None:
    bench = Bench()
    assert bench.window(20, 65).gyro is None
    assert bench.input.problem("/imu") == ""
    required = ImuInput(GyroConfig(use="require"), lambda *_: np.eye(3), bench.clock)
    assert required.problem("/imu").startswith("no message on /imu; remap imu:=TOPIC")


def test_forgotten_windows_do_not_come() -> None:
    bench = Bench()
    bench.send(0, 60)
    bench.input.hold([bench.task(20, 62)])
    assert bench.input.forget() == 1
    bench.send(60, 70)
    assert bench.input.ready() == []


FAULTS = {
    "readings that do not change": lambda t, w: (t, np.array([0.1, 0.2, 0.3])),
    "readings at the end of the range": lambda t, w: (t, np.radians([0, 2000.0, 0])),
    "readings that are not finite": lambda t, w: (t, np.array([np.nan, 0, 0])),
    "no readings": lambda t, w: (t - 3600 * S, w),
}


@pytest.mark.parametrize("reason", FAULTS)
def test_faults_are_noticed_within_half_a_second(reason: str) -> None:
    bench = Bench()
    bench.send(0, 200)
    gyro = Gyro(CONFIG)
    for end in range(200, 700, 45):
        bench.send(end, end + 45, FAULTS[reason])
        window = bench.window(end - 90, end)
        gyro.measure(window.t_start, window.t_end, window.gyro)
    assert str(gyro.status) == f"rejected ({reason})"
    bench.send(700, 1000)
    window = bench.window(850, 985)
    assert gyro.measure(window.t_start, window.t_end, window.gyro) is not None
    assert gyro.status.state is GyroState.USED


def test_an_imu_on_another_clock_is_named() -> None:
    bench = Bench()
    bench.send(0, 100, lambda t, w: (t - 1000 * S, w))
    window = bench.window(20, 65)
    assert judged(bench, window) == "rejected (no readings)"
    assert "the stamps of /imu are -1000.0 s from the events" in bench.input.problem("/imu")


def test_messages_that_cannot_be_read_are_left_out() -> None:
    bench = Bench()
    bench.send(0, 50)
    for data in (b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40):
        bench.input.take(data)
        assert bench.input.problem("/imu") == "/imu: a malformed message; check the driver"
    message = bytearray(ENCODER.imu(START + 50 * MS, ImuSample(np.zeros(3), np.zeros(3))))
    frame = message[16:].index(0) + 1
    start = 4 + -(-(12 + frame) // 8) * 8 + 16 * 8  # of the covariance of the rate
    message[start : start + 8] = np.array([-1.0]).tobytes()
    bench.input.take(bytes(message))
    assert "they have no gyroscope" in bench.input.problem("/imu")
    bench.send(50, 100)
    assert bench.input.problem("/imu") == ""
    assert len(bench.window(20, 65).gyro) == 46


def test_without_a_transform_windows_have_no_readings() -> None:
    asked = []

    def mounting(source: str, target: str):
        asked.append((source, target))
        if len(asked) == 1:
            raise MountingError("no transform from a to b")
        return np.eye(3)

    bench = Bench()
    bench.input = ImuInput(CONFIG, mounting, bench.clock)
    bench.send(0, 100)
    assert bench.window(20, 65).gyro is None
    assert bench.input.problem("/imu") == "no transform from a to b"
    assert bench.window(20, 65).gyro is not None
    assert asked == [("davis_left_imu", "camera")] * 2
    assert bench.input.problem("/imu") == ""


def test_a_message_costs_less_than_three_percent_of_a_core_at_1000_hz() -> None:
    bench = Bench()
    sample = ImuSample(np.ones(3), np.zeros(3))
    messages = [ENCODER.imu(START + k * MS, sample) for k in range(5000)]
    began = time.process_time()
    for message in messages:
        bench.input.take(message)
    assert (time.process_time() - began) / len(messages) < 30e-6


def test_the_buffer_is_bounded_and_ordered() -> None:
    buffer = ReadingBuffer()
    for t in range(70_000):
        buffer.add(t * MS, t, 0.0, 0.0)
    t, w = buffer.between(69_990 * MS, 80_000 * MS)
    assert (t // MS).tolist() == list(range(69_990, 70_000)) == w[:, 0].astype(int).tolist()
    kept, _ = buffer.all()
    assert 16_384 <= len(kept) <= 32_768
    buffer.add(69_998 * MS, 7.0, 0.0, 0.0)  # a little late
    assert len(buffer.all()[0]) == len(kept)
    buffer.add(5 * MS, 7.0, 0.0, 0.0)  # another run
    assert buffer.all()[0].tolist() == [5 * MS]
