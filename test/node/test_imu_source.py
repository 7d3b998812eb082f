"""The gyro in the pipeline: windows, diagnostics and status; the worker is a fake."""

import sys
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_node import FakeNode, install_fake_tf
from fake_supervisor import install_fake_supervisor
from graph import DVS
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Events, Window, WindowSlicer
from emoflow_ros.core.types.gyro import GyroReadings, GyroState, GyroStatus
from emoflow_ros.errors import InputError
from emoflow_ros.node.channel import pack, unpack
from emoflow_ros.node.pipeline import Pipeline
from emoflow_ros.node.reports import Level
from emoflow_ros.node.settings import NodeOptions, Settings
from emoflow_ros.node.tasks import Job, Result, Task
from emoflow_ros.node.topic_search import EventTopic
from emoflow_ros.simulation.messages import ImuSample, MessageEncoder

MS = 1_000_000
CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
ENCODER = MessageEncoder(ros1=False)
WINDOWS = {
    "input.queue_windows": 8,
    "output.twist_rate": 0.0,
}


class Bench:
    """A calibrated pipeline that listens to /left/events and /left/imu."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, windows_ms: float = 10.0, **imu: str | float
    ) -> None:
        supervisors = install_fake_supervisor(monkeypatch)
        self.node = FakeNode()
        values = {f"imu.{name}": value for name, value in imu.items()}
        values |= {"window.duration_ms": windows_ms, "window.stride_ms": windows_ms}
        self.settings = Settings(NodeOptions(), load_config()).changed(WINDOWS | values)
        self.pipeline = Pipeline(
            self.node,  # type: ignore[arg-type]
            self.settings,
            factory="",
            wake=lambda: None,
            made=ExitStack(),
        )
        if self.pipeline.imu is not None:
            self.pipeline.imu._input._clock = lambda: 0.0  # no window has waited long enough
        [self.supervisor] = supervisors
        self.listen("/left/events")

    def listen(self, topic: str) -> None:
        self.pipeline.take_topic(EventTopic(topic, DVS))
        info = deserialize_message(ENCODER.camera_info(0, CAMERA), CameraInfo)
        self.pipeline.take_camera_info(info)

    def events(self, first_ms: int, last_ms: int, late_ms: int = 0) -> None:
        """Events whose messages have stamps so much later."""
        for ms in range(first_ms, last_ms, 5):
            zero = np.zeros(1, np.uint16)
            events = Events(zero, zero, np.array([ms * MS]), zero.astype(bool))
            self.pipeline.take_events(ENCODER.events((ms + late_ms) * MS, CAMERA, events))
            self.pipeline.cut_windows()

    def imu(self, first_ms: int, last_ms: int) -> None:
        assert self.pipeline.imu is not None
        for ms in range(first_ms, last_ms):
            sample = ImuSample(np.array([ms, 0.0, 0.0]), np.zeros(3))
            self.node.sent.append(ENCODER.imu(ms * MS, sample))
        fetching, _ = self.node.timers
        fetching.fire()

    def answer(self, job: Job, gyro: GyroStatus) -> None:
        window = job.task.window
        estimate = Estimate(
            window.t_start, window.t_end, window.t_start, Status.NO_MOTION, Quality(1), gyro=gyro
        )
        self.supervisor.outcomes.put(Result(job.task, estimate))
        self.pipeline.take_outcomes()


def test_windows_go_to_the_worker_with_their_readings(monkeypatch) -> None:
    bench = Bench(monkeypatch, use="auto", rotation="0,0,90")
    bench.imu(990, 1011)
    bench.events(1000, 1021)
    [first] = bench.supervisor.jobs()  # 1000 to 1010; the next one waits for its end
    assert (first.task.window.gyro.t // MS).tolist() == list(range(1000, 1011))
    np.testing.assert_allclose(first.task.window.gyro.w[0], [0, 1000, 0], atol=1e-9)
    bench.imu(1011, 1022)
    [second] = bench.supervisor.jobs()
    assert (second.task.window.gyro.t // MS).tolist() == list(range(1010, 1021))


def test_the_imu_of_another_event_topic_starts_anew(monkeypatch) -> None:
    bench = Bench(monkeypatch, use="auto")
    bench.imu(990, 1011)
    bench.events(1000, 1011)
    assert bench.supervisor.jobs()[0].task.window.gyro is not None
    bench.listen("/right/events")
    bench.events(1000, 1011)
    [job] = bench.supervisor.jobs()
    assert job.task.window.gyro is None  # not a reading of the left camera's IMU


def test_a_window_that_waits_is_handed_on_by_the_timer(monkeypatch) -> None:
    bench = Bench(monkeypatch, use="auto")
    bench.imu(990, 1005)
    bench.events(1000, 1011)
    assert bench.supervisor.jobs() == []
    bench.pipeline.imu._input._clock = lambda: 1e12
    _, looking = bench.node.timers
    looking.fire()
    [job] = bench.supervisor.jobs()
    assert job.task.window.gyro.t[-1] == 1004 * MS


def test_windows_that_wait_are_forgotten_with_their_epoch(monkeypatch) -> None:
    bench = Bench(monkeypatch, use="auto")
    bench.imu(990, 1005)
    bench.events(1000, 1011)
    bench.events(100, 106)  # the second message confirms the jump
    bench.imu(1005, 1015)
    assert bench.supervisor.jobs() == []
    assert bench.pipeline.statistics.counts["windows_forgotten"] == 1


def test_off_hears_no_imu(monkeypatch) -> None:
    bench = Bench(monkeypatch)
    assert bench.pipeline.imu is None
    bench.events(1000, 1011)
    [job] = bench.supervisor.jobs()
    assert job.task.window.gyro is None


@pytest.mark.parametrize(("use", "level"), [("auto", Level.WARN), ("require", Level.ERROR)])
def test_diagnostics_and_status_tell_what_became_of_the_gyro(monkeypatch, use, level) -> None:
    bench = Bench(monkeypatch, use=use)
    bench.imu(990, 1045)
    bench.events(1000, 1041)
    jobs = bench.supervisor.jobs()
    reason = "gyro and events disagree: 78 % of windows, axis x inverted?"
    bench.answer(jobs[0], GyroStatus(GyroState.REJECTED, reason))
    report = bench.pipeline.report()
    assert (report.level, report.message) == (level, f"gyro: rejected ({reason})")
    assert report.values["gyro"] == f"rejected ({reason})"
    [status] = bench.node.messages("egomotion/status")
    assert {v.key: v.value for v in status.values}["gyro"] == f"rejected ({reason})"
    bench.answer(jobs[1], GyroStatus(GyroState.USED))
    report = bench.pipeline.report()
    assert (report.level, report.values["gyro"]) == (Level.OK, "used")


def turning(ms: float) -> np.ndarray:
    """Angular velocity of a camera in a hand at a time of the events, ms."""
    return 0.4 * np.sin(2e-3 * np.pi * ms * np.array([0.7, 1.1, 1.9]) + [0.0, 1.0, 2.0])


@pytest.mark.parametrize("late_ms", [400, 0])
@pytest.mark.parametrize(("ahead_ms", "said"), [(600, "0.65"), (-600, "-0.55")])
def test_a_gyro_on_another_clock_is_refused_until_turning_tells_the_offset(
    monkeypatch, late_ms: int, ahead_ms: int, said: str
) -> None:
    """Its stamps are ahead of event times; the messages of both come at the same moment."""
    bench = Bench(monkeypatch, windows_ms=50.0, use="require")
    tasks = []
    for ms in range(1000, 7000, 50):
        for stamp in range(ms, ms + 50, 2):
            sample = ImuSample(turning(stamp) + np.radians([1.0, -2.0, 0.5]), np.zeros(3))
            bench.node.sent.append(ENCODER.imu((stamp + ahead_ms) * MS, sample))
        bench.events(ms, ms + 50, late_ms=late_ms)
        for job in bench.supervisor.jobs():
            tasks.append(job.task)
            window, gyro = job.task.window, job.task.window.gyro
            middle = (window.t_start + window.t_end) // 2
            estimate = Estimate(
                *(window.t_start, window.t_end, middle, Status.OK, Quality(1)),
                angular=turning(middle / MS),
                gyro=GyroStatus(GyroState.USED if gyro else GyroState.NONE),
            )
            bench.supervisor.outcomes.put(Result(job.task, estimate))
        bench.pipeline.take_outcomes()
        if ms == 3000:
            report = bench.pipeline.report()
    assert (report.level, report.message) == (
        Level.ERROR,
        f"gyro: the stamps of /left/imu are {said} s from the events: on another clock, or one "
        "comes late; not used until turning the camera tells which, or imu.time_offset_ms is set "
        "(evaluate --check-imu)",
    )
    used = [task.window for task in tasks if task.window.gyro is not None]
    assert 40 < len(used) < len(tasks) - 30
    for window in used:
        inside = window.gyro.covering(window.t_start, window.t_end, 0)
        truth = np.array([turning(t / MS) for t in inside.t]) + np.radians([1.0, -2.0, 0.5])
        assert np.abs(inside.w - truth).max() < np.radians(1.0)  # 4 ms
    assert bench.pipeline.report().level is Level.OK
    [line] = [line for _, line in bench.node.log if "used with its stamps" in line]
    assert abs(int(line.split("stamps ")[1].split(" ms")[0]) + ahead_ms) <= 4


@pytest.mark.parametrize(
    ("late_ms", "ahead_ms", "offset_ms"),
    [(20, 20, 0.0), (400, 0, 0.0), (0, 200, 0.0), (400, 400, -400.0)],
)
def test_a_gyro_on_the_events_clock_or_with_a_given_offset_is_used_at_once(
    monkeypatch, late_ms: int, ahead_ms: int, offset_ms: float
) -> None:
    bench = Bench(monkeypatch, use="require", time_offset_ms=offset_ms)
    bench.imu(990 + ahead_ms, 1045 + ahead_ms)
    bench.events(1000, 1041, late_ms=late_ms)
    assert bench.pipeline.report().level is Level.OK
    assert all(job.task.window.gyro is not None for job in bench.supervisor.jobs())


def test_a_required_imu_that_is_not_there_is_an_error(monkeypatch) -> None:
    bench = Bench(monkeypatch, use="require")
    bench.events(1000, 1011)
    report = bench.pipeline.report()
    assert report.level is Level.ERROR
    assert report.message.startswith("gyro: no message on /left/imu; remap imu:=TOPIC")
    assert len(bench.supervisor.jobs()) == 1
    bench.pipeline.pause()
    assert bench.pipeline.report().level is Level.OK


def test_the_mounting_may_come_from_tf(monkeypatch) -> None:
    tf = install_fake_tf(monkeypatch)
    bench = Bench(monkeypatch, use="auto", rotation="tf")
    bench.imu(990, 1015)
    bench.events(1000, 1011)
    assert bench.supervisor.jobs()[0].task.window.gyro is None
    assert bench.pipeline.report().message == (
        "gyro: no transform from davis_left_imu to davis_left_optical: not yet"
    )
    tf.known = True
    bench.imu(1015, 1025)
    bench.events(1015, 1021)
    gyro = bench.supervisor.jobs()[0].task.window.gyro
    np.testing.assert_allclose(gyro.w[0], [0, -1010, 0], atol=1e-9)
    assert tf.asked[-1] == ("davis_left_optical", "davis_left_imu", 0)


def test_without_tf2_the_mounting_cannot_come_from_tf(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    with pytest.raises(InputError, match=r"^imu\.rotation: tf needs .* give imu\.rotation as roll"):
        Bench(monkeypatch, use="auto", rotation="tf")


def test_the_gyros_status_crosses_the_channel() -> None:
    status = GyroStatus(GyroState.REJECTED, "no readings")
    task = Task(Window(0, 1, Events.empty()), 0, 0, "camera", 0.0)
    estimate = Estimate(0, 1, 0, Status.NO_MOTION, Quality(events=1), gyro=status)
    result = unpack(task, *pack(estimate))
    assert result.estimate.gyro == status
    assert not result.has_flow
    lattice = Lattice(20, 20, 2, 2, 2)
    flow = LatticeFlow(lattice, np.zeros(lattice.shape, np.float32), 0, 1)
    assert unpack(task, *pack(replace(estimate, flow=flow))).has_flow


def test_the_node_gives_windows_the_readings_that_they_have_offline(monkeypatch) -> None:
    bench = Bench(monkeypatch, use="auto", rotation="5,-3,90", time_offset_ms=2.5)
    rng = np.random.default_rng(0)
    jobs, all_events, all_readings = [], [], []
    for ms in range(1000, 1200, 5):
        t = np.sort(rng.integers(ms * MS, (ms + 5) * MS, 40)) // 1000 * 1000
        x = np.zeros(40, np.uint16)
        events = Events(x, x, t, x.astype(bool))
        for stamp in range(ms * MS, (ms + 5) * MS, 2 * MS):
            w = rng.normal(size=3)
            all_readings.append((stamp, w))
            bench.node.sent.append(ENCODER.imu(stamp, ImuSample(w, np.zeros(3))))
        bench.pipeline.take_events(ENCODER.events(ms * MS, CAMERA, events))
        bench.pipeline.cut_windows()
        all_events.append(events)
        jobs += bench.supervisor.jobs()
    config = bench.settings.config
    t, w = (np.array(part) for part in zip(*all_readings, strict=True))
    readings = GyroReadings.mounted(t, w, config.imu.matrix(), config.imu.time_offset_ns)
    offline = WindowSlicer(config.window).push(Events.concatenate(all_events))
    assert len(jobs) >= 18
    for job, window in zip(jobs, offline, strict=False):
        ours, theirs = job.task.window, window.with_gyro(readings)
        assert (ours.t_start, ours.t_end) == (theirs.t_start, theirs.t_end)
        np.testing.assert_array_equal(ours.gyro.t, theirs.gyro.t)
        np.testing.assert_array_equal(ours.gyro.w, theirs.gyro.w)
