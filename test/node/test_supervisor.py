import os
import queue
import re
import signal
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from supervisor_bench import CAMERA, WAIT_S, Bench

from emoflow_ros import compiled_code
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import flow_to_rgb
from emoflow_ros.core.types.estimate import MotionModel, Status
from emoflow_ros.node import supervisor
from emoflow_ros.node.tasks import Loss, Picture, Wishes
from emoflow_ros.node.worker_process import WorkerProcess


def test_windows_go_through_the_worker_unchanged(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.put(count=5, t=2000)
    estimate = b.result().estimate
    assert (estimate.t_start, estimate.t, estimate.t_end) == (2000, 2050, 2100)
    assert estimate.status is Status.OK
    assert estimate.model is MotionModel.FULL
    np.testing.assert_array_equal(estimate.angular, [5, 1, CAMERA.width])
    np.testing.assert_array_equal(estimate.covariance, np.eye(6))
    assert estimate.quality.stop_reason == "converged"


def test_pictures_come_only_when_wished_for(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.put()
    assert b.result().pictures == {}
    b.wishes = Wishes((Picture.FLOW,))
    b.put()
    [flow] = b.result().pictures.values()
    assert flow.shape == (24, 32, 2)
    assert np.isnan(flow[:, 0]).all()
    np.testing.assert_array_equal(flow[5, 1], [1, -2])
    b.wishes = Wishes((Picture.COLOR, Picture.EVENTS), flow_color_max=100.0)
    b.put(x=3)
    pictures = b.result().pictures
    assert set(pictures) == {Picture.COLOR, Picture.EVENTS}
    np.testing.assert_array_equal(pictures[Picture.COLOR], flow_to_rgb(flow, 100.0))
    assert pictures[Picture.EVENTS][0, 3] == 255
    assert np.count_nonzero(pictures[Picture.EVENTS]) == 1


def test_worker_that_had_to_compile_is_replaced_once(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The replacement is kept, although this one compiles, too. It is of another server."""
    started = []
    servers = set()

    class Counted(WorkerProcess):
        def __init__(self, *args: Any) -> None:
            super().__init__(*args)
            started.append(self.pid)
            servers.add(psutil.Process(self.pid).ppid())

    monkeypatch.setattr(supervisor, "WorkerProcess", Counted)
    for factory, count in (("Compiler", 2), ("Recorder", 1)):
        started.clear()
        servers.clear()
        b = bench(factory)
        b.put()
        answered = b.result().estimate.angular[0]
        assert len(started) == len(servers) == count
        assert b.supervisor.pid == started[-1]
        assert factory == "Recorder" or answered == started[-1]


def test_start_that_compiles_is_said_at_once_and_at_its_end(bench: Callable[..., Bench]) -> None:
    b = bench("Compiler")
    first, last = b.progress()[:2]  # the worker that replaces this one compiles, too
    assert first == (
        "the estimator is compiled, as at the first start on a machine: it takes about a minute, "
        f"and is kept in {compiled_code.folder()}"
    )
    wanted = r"the estimator is compiled now: \d+ functions in \d+ s"
    assert re.fullmatch(wanted, last)
    assert b.supervisor.obstacle == ""
    assert bench("Recorder").progress() == []


def test_new_epoch_starts_cold(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    counts = []
    for epoch in (0, 0, 1, 1):
        b.put(epoch=epoch)
        counts.append(b.result().estimate.angular[1])
    assert counts == [1, 2, 1, 2]


def test_new_camera_takes_effect_at_the_next_window(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.put()
    assert b.result().estimate.angular[2] == 32
    b.camera = Camera(64, 48, 40.0, 40.0, 32.0, 24.0)
    b.put()
    assert b.result().estimate.angular[2] == 64


def test_dying_worker_costs_one_window(bench: Callable[..., Bench]) -> None:
    b = bench("Dying")
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
    b.put()
    b.result()
    first = b.supervisor.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    assert b.loss() == Loss("the worker died (signal 9); it is started again", worker=True)
    b.put()
    assert b.result().estimate.quality.events == 5
    assert b.supervisor.pid != first


def test_worker_that_has_answered_is_replaced_without_a_pause(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    b = bench("Recorder")
    pauses: list[float] = []
    monkeypatch.setattr(b.supervisor._stopping, "wait", pauses.append)
    for _ in range(2):
        b.put()
        b.result()
        assert b.supervisor.pid is not None
        os.kill(b.supervisor.pid, signal.SIGKILL)
        b.loss()
    b.put()
    b.result()
    assert pauses == [0.0, 0.0]


def test_hanging_worker_is_replaced_after_the_timeout(bench: Callable[..., Bench]) -> None:
    b = bench("Hanging", timeout_s=2.0)
    b.put(x=7)
    b.put()
    assert "no answer in 2 s" in b.loss().reason
    assert b.result().estimate.quality.events == 5


def test_exception_costs_the_window_but_not_the_worker(bench: Callable[..., Bench]) -> None:
    b = bench("Raising")
    b.put()
    b.result()
    first = b.supervisor.pid
    b.put(x=7)
    loss = b.loss()
    reason, _, file = loss.reason.partition("; traceback in ")
    assert (reason, loss.worker) == ("a window failed: FloatingPointError: no luck", False)
    assert Path(file).read_text().rstrip().endswith("FloatingPointError: no luck")
    b.put()
    assert b.result().estimate.angular[1] == 1  # reset: started cold
    assert b.supervisor.pid == first


def test_worker_tells_its_processor_time_and_for_how_long_it_is_busy(
    bench: Callable[..., Bench],
) -> None:
    b = bench("Slow")  # sleeps for 50 ms
    b.put()
    result = b.result()
    assert result.wall_s > 0.05
    assert 0 <= result.processor_s < result.wall_s - 0.04
    b = bench("Busy")
    assert b.supervisor.busy_s == 0.0
    b.put()
    deadline = time.monotonic() + WAIT_S
    while b.supervisor.busy_s < 0.2:
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize("nice", [0, 7])
def test_worker_has_the_priority_of_the_node_or_a_lower_one(nice: int) -> None:
    worker = WorkerProcess(get_context("forkserver"), "fake_estimators:Recorder", 10.0, nice)
    try:
        worker.request({"kind": "warm_up"}, {}, WAIT_S)
        assert worker.pid is not None
        assert psutil.Process(worker.pid).nice() == min(19, psutil.Process().nice() + nice)
    finally:
        worker.end()


def test_stop_ends_a_busy_worker_at_once(bench: Callable[..., Bench]) -> None:
    b = bench("Busy")
    pid = b.supervisor.pid
    assert pid is not None
    b.put()
    time.sleep(0.2)
    b.supervisor.stop()  # it would be busy for ever
    with pytest.raises(queue.Empty):
        b.outcomes.get(timeout=0.1)
    deadline = time.monotonic() + WAIT_S
    while psutil.pid_exists(pid):
        assert time.monotonic() < deadline, "the worker outlives its supervisor"
        time.sleep(0.01)


def test_worker_that_cannot_start_is_tried_again() -> None:
    b = Bench("Missing")
    b.supervisor.start()
    try:
        for _ in range(2):
            loss = b.loss()
            assert loss.worker
            assert "exit code 1" in loss.reason
        assert not b.supervisor.ready.is_set()
    finally:
        b.supervisor.stop()


def test_compiled_code_that_cannot_be_written_is_said_with_its_folder_and_what_to_do() -> None:
    b = Bench("FullDisk")
    b.supervisor.start()
    try:
        assert b.loss().reason == (
            "the worker cannot be started: compiled code: it cannot be kept in "
            f"{compiled_code.folder()} (no space left on device); make room there, or set "
            "NUMBA_CACHE_DIR to a folder that can be written and has 32 MiB; it is started again"
        )
    finally:
        b.supervisor.stop()
