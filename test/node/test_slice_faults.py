"""Faults while a slice is estimated: windows, and later slices, go on."""

import os
import signal
import threading
import time
from collections.abc import Callable

import psutil
import pytest
from supervisor_bench import WAIT_S, Bench, Clumsy

from emoflow_ros.node import worker_process


def test_slice_that_fails_costs_neither_a_window_nor_the_worker(
    bench: Callable[..., Bench],
) -> None:
    b = bench("Trackless")
    b.put(t=1000)
    b.result()
    first = b.supervisor.pid
    b.put_slice(t_end=1100)
    loss = b.loss()
    assert loss.reason.startswith("a slice failed: ValueError: no tracks")
    assert not loss.worker
    b.put(t=2000)
    assert b.result().estimate.angular[1] == 2  # the same estimator, still warm
    assert b.supervisor.pid == first


def test_slice_that_runs_out_of_memory_costs_the_worker(bench: Callable[..., Bench]) -> None:
    b = bench("Exhausted")
    b.put(t=1000)
    b.result()
    first = b.supervisor.pid
    b.put_slice(t_end=1100)
    losses = [b.loss(), b.loss()]
    assert [loss.worker for loss in losses].count(True) == 1
    assert all("a slice failed: MemoryError: no memory" in loss.reason for loss in losses)
    b.put(t=2000)
    assert b.result().estimate.angular[1] == 1  # a fresh estimator
    assert b.supervisor.pid != first


def wait_for_stop(pid: int) -> None:
    """Wait until a signal has stopped all threads of a process."""
    deadline = time.monotonic() + WAIT_S
    while {psutil.Process(t.id).status() for t in psutil.Process(pid).threads()} != {"stopped"}:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_worker_that_does_not_answer_a_slice_is_replaced(bench: Callable[..., Bench]) -> None:
    b = bench("Trackless", timeout_s=3.0)
    b.put(t=1000)
    b.result()
    assert b.supervisor.pid is not None
    os.kill(b.supervisor.pid, signal.SIGSTOP)
    wait_for_stop(b.supervisor.pid)
    b.put_slice(t_end=1100)
    ended = "the worker gave no answer in 3 s and was ended; it is started again"
    assert b.loss().reason == ended
    b.put(t=2000)
    assert b.result().estimate.angular[1] == 1


def test_error_in_the_slices_thread_is_told_and_later_slices_are_answered(
    bench: Callable[..., Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    b = bench("Recorder")
    monkeypatch.setattr(worker_process, "unpack_present", Clumsy(MemoryError("no memory"), 1))
    b.put(t=1000)
    b.result()
    b.put_slice(t_end=1100)
    losses = {b.loss().reason, b.loss().reason}
    error = "an error in the node (MemoryError: no memory)"
    assert losses == {error, f"{error}; it is started again"}
    asked = threading.Event()
    monkeypatch.setattr(worker_process, "unpack_present", lambda *_: asked.set())
    b.put(t=2000)
    b.result()
    b.put_slice(t_end=2100)
    assert asked.wait(WAIT_S)
