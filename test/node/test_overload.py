"""More windows and more events than can be estimated: what is estimated, dropped and counted.

Time is that of the events: a worker that needs a given time for a window is simulated, so that no
test here depends on the machine.
"""

from collections import Counter
from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_estimators import Recorder
from fake_node import FakeNode
from fake_supervisor import install_fake_supervisor
from graph import DVS
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.events import Events
from emoflow_ros.node.channel import pack_window
from emoflow_ros.node.pipeline import Pipeline
from emoflow_ros.node.settings import NodeOptions, Settings
from emoflow_ros.node.tasks import Job, Result
from emoflow_ros.node.topic_search import EventTopic
from emoflow_ros.simulation.messages import MessageEncoder

MS = 1_000_000
CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
DURATION_MS, STRIDE_MS, MESSAGE_MS = 30, 10, 1
ENCODER = MessageEncoder(ros1=False)
FIRST_MS = 1000


class Overload:
    """A pipeline with the default queue, and a worker that needs `service_ms` for a window.

    Attributes:
        done: each job with the times at which its window was complete and its estimate there, ms.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, service_ms: float, **changes: float):
        supervisors = install_fake_supervisor(monkeypatch)
        self.node = FakeNode()
        options = {
            "window.duration_ms": float(DURATION_MS),
            "window.stride_ms": float(STRIDE_MS),
            "output.twist_rate": 0.0,
        }
        changed = {name.replace("__", "."): value for name, value in changes.items()}
        self.settings = Settings(NodeOptions(), load_config()).changed({**options, **changed})
        self.pipeline = Pipeline(
            self.node,  # type: ignore[arg-type]
            self.settings,
            factory="",
            wake=lambda: None,
            made=ExitStack(),
        )
        [self.supervisor] = supervisors
        self.pipeline.take_topic(EventTopic("/left/events", DVS))
        info = deserialize_message(ENCODER.camera_info(0, CAMERA), CameraInfo)
        self.pipeline.take_camera_info(info)
        self.done: list[tuple[Job, float, float]] = []
        self._service_ms = service_ms
        self._free_ms = 0.0

    def play(self, duration_ms: int, per_message: int = 4) -> None:
        """Take messages of 1 ms; the worker takes a window as soon as it is free."""
        for ms in range(FIRST_MS, FIRST_MS + duration_ms, MESSAGE_MS):
            t = ms * MS + np.arange(per_message) * (MESSAGE_MS * MS) // per_message
            x = np.arange(per_message).astype(np.uint16)
            events = Events(x % 64, x // 64 % 48, t, x % 2 == 0)
            self.pipeline.take_events(ENCODER.events(ms * MS, CAMERA, events))
            self.pipeline.cut_windows()
            self._work(ms)

    def _work(self, now_ms: float) -> None:
        while self._free_ms <= now_ms and (job := self.supervisor.queue.get(0.0)):
            self._free_ms = now_ms + self._service_ms
            self.done.append((job, job.task.window.t_end / MS, self._free_ms))
            estimate = Recorder(job.camera, job.config).estimate(job.task.window)
            self.supervisor.outcomes.put(Result(job.task, estimate))

    @property
    def counts(self) -> Counter[str]:
        self.pipeline.take_outcomes()
        return self.pipeline.statistics.counts


@pytest.mark.parametrize("times", [2, 5, 10])
def test_overload_keeps_the_latency_and_drops_evenly(monkeypatch, times):
    """A window waits at most until the next one is complete, whatever the overload."""
    bench = Overload(monkeypatch, service_ms=times * STRIDE_MS)
    bench.play(3000)
    waits = [end - complete - times * STRIDE_MS for _, complete, end in bench.done]
    assert min(waits) >= 0
    assert max(waits) <= STRIDE_MS + MESSAGE_MS
    starts = [job.task.window.t_start // MS for job, _, _ in bench.done]
    steps = {(b - a) // STRIDE_MS for a, b in pairwise(starts)}
    assert steps <= {times, times + 1}  # the worker takes up each window within a message
    assert len(bench.done) == pytest.approx(300 / times, rel=0.1)


@pytest.mark.parametrize("times", [2, 5, 10])
def test_under_overload_every_window_and_event_is_accounted_for_once(monkeypatch, times):
    bench = Overload(monkeypatch, service_ms=times * STRIDE_MS)
    bench.play(1000)
    counts = bench.counts
    assert counts["windows"] == (1000 - DURATION_MS - 1) // STRIDE_MS + 1
    assert counts["windows_ok"] == len(bench.done)
    waiting = len(bench.supervisor.queue)
    assert waiting <= 1
    assert counts["windows"] == counts["windows_ok"] + counts["windows_dropped"] + waiting
    assert counts["events"] == 4000
    assert counts["events_thinned"] == 0
    said = [m for m in bench.node.messages("egomotion/status") if m.message.startswith("dropped")]
    stamps = [int(m.values[0].value.replace(".", "")) for m in said]  # of the windows' middles
    dropped = np.zeros(4000, np.bool_)  # by the time of the event
    for stamp in stamps:
        start = stamp // MS - DURATION_MS // 2 - FIRST_MS
        dropped[4 * start : 4 * (start + DURATION_MS)] = True
    assert len(stamps) == counts["windows_dropped"]
    assert counts["events_dropped"] == dropped.sum()


def test_estimates_come_in_the_order_of_time(monkeypatch):
    bench = Overload(monkeypatch, service_ms=35)
    bench.play(1000)
    bench.pipeline.take_outcomes()
    published = [m.header.stamp for m in bench.node.messages("egomotion/twist")]
    times = [s.sec * 1000 * MS + s.nanosec for s in published]
    assert times == [job.task.stamp for job, _, _ in bench.done]
    assert all(a < b for a, b in pairwise(times))


def test_a_worker_that_keeps_up_gets_every_window(monkeypatch):
    bench = Overload(monkeypatch, service_ms=9)
    bench.play(1000)
    counts = bench.counts
    assert counts["windows_dropped"] == counts["events_dropped"] == 0
    assert counts["windows_ok"] == counts["windows"] == 97


def test_who_wants_every_window_gets_them_later(monkeypatch):
    bench = Overload(monkeypatch, service_ms=20, input__queue_windows=100)
    bench.play(1000)
    assert bench.counts["windows_dropped"] == 0
    starts = [job.task.window.t_start // MS - FIRST_MS for job, _, _ in bench.done]
    assert starts == list(range(0, STRIDE_MS * len(starts), STRIDE_MS))
    lag = [end - complete for _, complete, end in bench.done]
    assert lag[-1] > 10 * lag[0]


def test_more_events_than_are_used_are_counted_as_they_came_and_do_not_cross(monkeypatch):
    """100 events per ms may stay of 400, 1000 in 10 ms; the worker is twice too slow."""
    few = {"estimator__max_events": 1000, "estimator__tracked_events": 1000}
    bench = Overload(monkeypatch, service_ms=2 * STRIDE_MS, **few)
    bench.play(500, per_message=400)
    counts = bench.counts
    assert counts["events"] == 500 * 400
    assert counts["events_thinned"] == 499 * 300  # the last millisecond is not over
    budget = EventBudget(bench.settings.config.window, 1000)
    for job, _, _ in bench.done:
        thinned = job.thinned().task.window
        events = thinned.events
        assert events.came == job.task.window.events.came == DURATION_MS * 400
        assert len(events) <= budget.capacity < 2400
        _, arrays = pack_window(thinned)
        assert sum(array.nbytes for array in arrays.values()) <= 11 * budget.capacity
    of_dropped = counts["events_dropped"]
    assert of_dropped % (STRIDE_MS * 400) == 0
    assert of_dropped > 400 * 400
    dropped = next(m for m in bench.node.messages("egomotion/status") if "dropped" in m.message)
    values = {v.key: v.value for v in dropped.values}
    assert values["events"] == str(DURATION_MS * 400)
