import os
import queue
import signal
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import MotionModel, Status
from emoflow_ros.core.events import Events
from emoflow_ros.core.flow_color import flow_to_rgb
from emoflow_ros.core.windows import Window
from emoflow_ros.node.pictures import Picture
from emoflow_ros.node.supervisor import Supervisor
from emoflow_ros.node.tasks import Loss, Outcome, Result, Task, Wishes

CAMERA = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
WAIT_S = 60.0


class Bench:
    """A supervisor with its outcomes."""

    def __init__(self, estimator: str, timeout_s: float) -> None:
        self.outcomes: queue.SimpleQueue[Outcome] = queue.SimpleQueue()
        self.supervisor = Supervisor(
            capacity=8,
            timeout_s=timeout_s,
            on_outcome=self.outcomes.put,
            factory=f"fake_estimators:{estimator}",
        )
        self.supervisor.start()

    def put(self, *, x: int = 0, count: int = 5, t: int = 1000, epoch: int = 0) -> None:
        events = Events(
            np.full(count, x, np.uint16),
            np.zeros(count, np.uint16),
            np.arange(t, t + count, dtype=np.int64),
            np.ones(count, bool),
        )
        task = Task(Window(t, t + 100, events), epoch, 0, "camera", time.monotonic())
        self.supervisor.queue.put(task)

    def result(self) -> Result:
        outcome = self.outcomes.get(timeout=WAIT_S)
        assert isinstance(outcome, Result), outcome
        return outcome

    def loss(self) -> Loss:
        outcome = self.outcomes.get(timeout=WAIT_S)
        assert isinstance(outcome, Loss), outcome
        return outcome


@pytest.fixture
def bench() -> Iterator[Callable[..., Bench]]:
    benches: list[Bench] = []

    def make(estimator: str, *, timeout_s: float = 10.0) -> Bench:
        benches.append(Bench(estimator, timeout_s))
        assert benches[-1].supervisor.ready.wait(WAIT_S)
        return benches[-1]

    yield make
    for made in benches:
        made.supervisor.stop()


def test_windows_go_through_the_worker_unchanged(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.supervisor.configure(CAMERA, Config())
    b.put(count=5, t=2000)
    estimate = b.result().estimate
    assert (estimate.t_start, estimate.t, estimate.t_end) == (2000, 2050, 2100)
    assert estimate.status is Status.OK
    assert estimate.model is MotionModel.FULL
    np.testing.assert_array_equal(estimate.angular, [5, 1, CAMERA.width])
    np.testing.assert_array_equal(estimate.covariance, np.eye(6))
    assert estimate.quality.stop_reason == "converged"


def test_windows_wait_until_the_camera_is_known(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.put()
    with pytest.raises(queue.Empty):
        b.outcomes.get(timeout=0.3)
    b.supervisor.configure(CAMERA, Config())
    assert b.result().estimate.quality.events == 5


def test_pictures_come_only_when_wished_for(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.supervisor.configure(CAMERA, Config())
    b.put()
    assert b.result().pictures == {}
    b.supervisor.wishes = Wishes((Picture.FLOW,))
    b.put()
    [flow] = b.result().pictures.values()
    assert flow.shape == (24, 32, 2)
    assert np.isnan(flow[:, 0]).all()
    np.testing.assert_array_equal(flow[5, 1], [1, -2])
    b.supervisor.wishes = Wishes((Picture.COLOR, Picture.EVENTS), flow_color_max=100.0)
    b.put(x=3)
    pictures = b.result().pictures
    assert set(pictures) == {Picture.COLOR, Picture.EVENTS}
    np.testing.assert_array_equal(pictures[Picture.COLOR], flow_to_rgb(flow, 100.0))
    assert pictures[Picture.EVENTS][0, 3] == 255
    assert np.count_nonzero(pictures[Picture.EVENTS]) == 1


def test_twists_of_overlapping_windows_join(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.supervisor.configure(CAMERA, Config())
    b.put(t=1000)
    [middle] = b.result().twists
    assert middle.t == 1050
    np.testing.assert_array_equal(middle.angular, [5, 1, CAMERA.width])
    b.supervisor.wishes = Wishes(twist_rate=1e9 / 40)
    seen = []
    for t, epoch in ((2000, 0), (2050, 0), (2000, 1)):
        b.put(t=t, epoch=epoch)
        seen.append([(int(w.t), int(w.angular[0])) for w in b.result().twists])
    assert seen == [
        [(2000, 0), (2040, 40), (2080, 80)],
        [(2120, 70)],
        [(2000, 0), (2040, 40), (2080, 80)],
    ]


def test_new_epoch_starts_cold(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.supervisor.configure(CAMERA, Config())
    counts = []
    for epoch in (0, 0, 1, 1):
        b.put(epoch=epoch)
        counts.append(b.result().estimate.angular[1])
    assert counts == [1, 2, 1, 2]


def test_new_camera_takes_effect_at_the_next_window(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.supervisor.configure(CAMERA, Config())
    b.put()
    assert b.result().estimate.angular[2] == 32
    b.supervisor.configure(Camera(64, 48, 40.0, 40.0, 32.0, 24.0), Config())
    b.put()
    assert b.result().estimate.angular[2] == 64


def test_dying_worker_costs_one_window(bench: Callable[..., Bench]) -> None:
    b = bench("Dying")
    b.supervisor.configure(CAMERA, Config())
    for x in (0, 7, 0, 0):
        b.put(x=x)
    b.result()
    loss = b.loss()
    assert loss.worker
    assert "signal 9" in loss.reason
    assert [b.result().estimate.quality.events for _ in range(2)] == [5, 5]
    assert b.supervisor.queue.dropped == 0


def test_worker_killed_while_idle_costs_nothing(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.supervisor.configure(CAMERA, Config())
    b.put()
    b.result()
    first = b.supervisor.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    assert b.loss() == Loss("the worker died (signal 9); it is started again", worker=True)
    b.put()
    assert b.result().estimate.quality.events == 5
    assert b.supervisor.pid != first


def test_hanging_worker_is_replaced_after_the_timeout(bench: Callable[..., Bench]) -> None:
    b = bench("Hanging", timeout_s=0.5)
    b.supervisor.configure(CAMERA, Config())
    b.put(x=7)
    b.put()
    assert "no answer in 0.5 s" in b.loss().reason
    assert b.result().estimate.quality.events == 5


def test_exception_costs_the_window_but_not_the_worker(bench: Callable[..., Bench]) -> None:
    b = bench("Raising")
    b.supervisor.configure(CAMERA, Config())
    b.put()
    b.result()
    first = b.supervisor.pid
    b.put(x=7)
    assert b.loss() == Loss("a window failed: FloatingPointError: no luck", worker=False)
    b.put()
    assert b.result().estimate.angular[1] == 1  # reset: started cold
    assert b.supervisor.pid == first


def test_estimate_that_is_not_finite_has_diverged(bench: Callable[..., Bench]) -> None:
    b = bench("NotFinite")
    b.supervisor.configure(CAMERA, Config())
    b.put(x=7)
    assert b.result().estimate.status is Status.DIVERGED
    b.put()
    assert b.result().estimate.status is Status.OK


def test_stop_ends_a_busy_worker_at_once(bench: Callable[..., Bench]) -> None:
    b = bench("Busy")
    b.supervisor.configure(CAMERA, Config())
    pid = b.supervisor.pid
    assert pid is not None
    b.put()
    time.sleep(0.2)
    started = time.monotonic()
    b.supervisor.stop()
    assert time.monotonic() - started < 0.9
    with pytest.raises(queue.Empty):
        b.outcomes.get(timeout=0.1)
    for _ in range(100):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        time.sleep(0.01)
    pytest.fail("the worker outlives its supervisor")


def test_worker_that_cannot_start_is_tried_again() -> None:
    b = Bench("Missing", 10.0)
    try:
        for _ in range(2):
            loss = b.loss()
            assert loss.worker
            assert "exit code 1" in loss.reason
        assert not b.supervisor.ready.is_set()
    finally:
        b.supervisor.stop()
