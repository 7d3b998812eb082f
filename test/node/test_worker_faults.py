"""Faults inside the worker: what becomes of the window, of the worker and of the next window."""

import multiprocessing
import os
import queue
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest
from supervisor_bench import CAMERA, WAIT_S, Bench, Clumsy

from emoflow_ros.config import load_config
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.errors import InputError
from emoflow_ros.node import supervisor
from emoflow_ros.node.channel import Channel

ON_CUDA = load_config("paper", {"estimator.device": "cuda"})


def test_out_of_memory_costs_the_window_and_the_worker(bench: Callable[..., Bench]) -> None:
    b = bench("Greedy")
    b.put()
    b.result()
    first = b.supervisor.pid
    b.put(x=7)
    loss = b.loss()
    assert loss.worker
    assert "Unable to allocate 4.00 GiB" in loss.reason
    assert loss.task is not None
    b.put()
    assert b.result().estimate.angular[1] == 1  # cold
    assert b.supervisor.pid != first


def test_twenty_kills_cost_at_most_a_window_each(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    pids = set()
    for kill in range(20):
        b.put(t=1000 * (kill + 1))
        assert b.result().estimate.angular[1] == 1  # each in a fresh worker
        pid = b.supervisor.pid
        assert pid is not None
        pids.add(pid)
        os.kill(pid, signal.SIGKILL)
        assert "signal 9" in b.loss().reason
    assert len(pids) == 20
    assert b.supervisor.queue.dropped == 0


def test_answer_in_time_keeps_its_worker_however_late_it_is_taken(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    b = bench("Recorder", timeout_s=2.0)
    first = b.supervisor.pid
    receive = Channel.receive

    def late(channel: Channel, *timeout_s: float) -> Any:
        answer = receive(channel, *timeout_s)
        time.sleep(2.2)  # this thread had no turn for longer than the time for a window
        return answer

    monkeypatch.setattr(Channel, "receive", late)
    for t in (1000, 2000):
        b.put(t=t)
        assert b.result().task.window.t_start == t
    assert b.supervisor.pid == first
    with pytest.raises(queue.Empty):
        b.outcomes.get(timeout=0.3)


def test_worker_that_stops_reading_is_replaced_after_the_timeout(
    bench: Callable[..., Bench],
) -> None:
    b = bench("Recorder", timeout_s=2.0)
    b.put()
    b.result()
    assert b.supervisor.pid is not None
    os.kill(b.supervisor.pid, signal.SIGSTOP)
    b.put(count=1_000_000)  # more than the connection holds
    loss = b.loss()
    assert "the worker gave no answer in 2 s" in loss.reason
    assert loss.task is not None
    b.put()
    assert b.result().estimate.quality.events == 5


def test_message_that_is_not_finished_ends_the_wait() -> None:
    ours, theirs = multiprocessing.Pipe()
    channel = Channel(ours, stall_s=0.1)
    theirs.send_bytes(b'[{}, [["linear", "<f8", [3]]]]')
    with pytest.raises(TimeoutError, match="not finished"):
        channel.receive(60.0)
    with pytest.raises(TimeoutError, match=r"no message in 0.1 s"):
        channel.receive(0.1)


@pytest.mark.parametrize("error", [MemoryError("no memory"), RuntimeError("no new thread")])
def test_any_error_in_the_thread_costs_one_window_and_tells_its_traceback(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    b = bench("Recorder")
    clumsy, unpack = Clumsy(error, 1), supervisor.unpack

    def fails_once(*args: Any) -> Any:
        clumsy()
        return unpack(*args)

    monkeypatch.setattr(supervisor, "unpack", fails_once)
    b.put(t=1000)
    b.put(t=2000)
    loss = b.loss()
    assert loss.reason == (
        f"an error in the node ({type(error).__name__}: {error}); the worker is started again"
    )
    assert loss.worker
    assert loss.task is not None
    assert loss.task.window.t_start == 1000
    assert "in fails_once" in loss.trace
    assert b.result().task.window.t_start == 2000
    assert not b.supervisor.has_ended


def test_error_of_who_is_woken_costs_no_window(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    b.wake = Clumsy(OSError("gone"), 2)
    b.put(t=1000)
    assert b.result().task.window.t_start == 1000
    loss = b.loss()
    assert "OSError: gone" in loss.reason
    assert loss.task is None
    b.put(t=2000)
    assert b.result().task.window.t_start == 2000


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_thread_that_ends_nevertheless_is_known(bench: Callable[..., Bench]) -> None:
    b = bench("Recorder")
    assert not b.supervisor.has_ended
    b.wake = Clumsy(SystemExit(), 1)  # type: ignore[arg-type]
    b.put()
    b.result()
    deadline = time.monotonic() + WAIT_S
    while not b.supervisor.has_ended:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    b.supervisor.stop()
    assert not b.supervisor.has_ended  # as it should be


def test_what_keeps_windows_from_being_estimated_is_known(bench: Callable[..., Bench]) -> None:
    b = bench("Dying")
    assert b.supervisor.obstacle == ""
    b.put(x=7)
    reason = b.loss().reason
    assert b.supervisor.obstacle == reason == "the worker died (signal 9); it is started again"
    b.put()
    b.result()
    assert b.supervisor.obstacle == ""


def test_estimate_that_is_not_finite_has_diverged(bench: Callable[..., Bench]) -> None:
    b = bench("NotFinite")
    b.put()
    assert b.result().estimate.angular[1] == 1
    b.put(x=7)
    bad = b.result()
    assert bad.estimate.status is Status.DIVERGED
    assert bad.pictures == {}
    b.put()
    good = b.result().estimate
    assert good.status is Status.OK
    assert good.angular[1] == 1  # cold: the state with the bad values is gone


def test_missing_device_falls_back_to_the_cpu_where_allowed(bench: Callable[..., Bench]) -> None:
    b = bench("NoCuda", may_use_cpu=True)
    b.config = ON_CUDA
    b.put()
    assert b.notice().reason == (
        "estimator.device: no CUDA device was found; use cpu; "
        "estimating on the CPU until configured anew"
    )
    assert b.result().estimate.status is Status.OK
    b.put()
    assert b.result().estimate.angular[1] == 2  # said once, and the worker is the same


def test_missing_device_is_refused_where_asked_for() -> None:
    b = Bench("NoCuda")
    with pytest.raises(InputError, match=r"no CUDA device was found.*on_missing_device"):
        b.supervisor.check(ON_CUDA)
    assert b.supervisor.pid is None
    assert not multiprocessing.active_children()
    assert not b.supervisor.ready.is_set()


def test_device_that_is_there_passes_the_check(bench: Callable[..., Bench]) -> None:
    b = Bench("Recorder")
    try:
        b.supervisor.check(ON_CUDA)
        checked = b.supervisor.pid
        b.config = ON_CUDA
        b.supervisor.start()
        b.put()
        assert b.result().estimate.angular[2] == CAMERA.width
        assert b.supervisor.pid == checked
    finally:
        b.supervisor.stop()


def test_lost_device_costs_the_window_and_the_cpu_goes_on(bench: Callable[..., Bench]) -> None:
    b = bench("LosesCuda", may_use_cpu=True)
    b.config = ON_CUDA
    b.put(x=7)
    assert "CUDA error: unspecified launch failure look at dmesg" in b.notice().reason
    loss = b.loss()
    assert loss.worker
    assert loss.task is not None
    b.put(x=7)
    assert b.result().estimate.status is Status.OK  # on the CPU


def test_lost_device_is_tried_again_where_the_cpu_is_refused(bench: Callable[..., Bench]) -> None:
    b = bench("LosesCuda")
    b.config = ON_CUDA
    for _ in range(2):
        b.put(x=7)
        assert "CUDA error" in b.loss().reason
    b.put()
    assert b.result().estimate.status is Status.OK  # on the device again


@pytest.mark.parametrize("profile", ["realtime", "rigid", "paper", "paper_dsec"])
def test_every_profile_reaches_the_worker(bench: Callable[..., Bench], profile: str) -> None:
    b = bench("ByProfile")
    b.config = load_config(profile, {"window.duration_ms": 70.0})
    b.put()
    assert b.result().estimate.quality.stop_reason == f"{profile} 70.0"
