"""Faults many times over: minutes each, run by `make soak`."""

import os
import signal
from pathlib import Path

import pytest
from harness import MS, Peer, Processes, children
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

pytestmark = [pytest.mark.dds, pytest.mark.soak]

LIFECYCLES = 50
KILLS = 20
OVERLOAD_WINDOWS = 60_000  # 10 minutes at 100 windows a second, five times what is possible


def resident_mb(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


def worker_of(pid: int) -> list[int]:
    return [worker for child in children(pid) for worker in children(child)]


def resources(pid: int) -> tuple[int, int, int]:
    """Count the threads, open files and processes below."""
    threads, files = (len(list(Path(f"/proc/{pid}/{kind}").iterdir())) for kind in ("task", "fd"))
    return threads, files, len(children(pid)) + len(worker_of(pid))


def test_lifecycles_leak_nothing(peer: Peer, processes: Processes) -> None:
    node = processes.start_fake("Recorder", "-p", "autostart:=false")
    seen = []
    for _ in range(LIFECYCLES):
        for transition in (
            Transition.TRANSITION_CONFIGURE,
            Transition.TRANSITION_ACTIVATE,
            Transition.TRANSITION_DEACTIVATE,
            Transition.TRANSITION_CLEANUP,
        ):
            wish = Transition(id=transition)
            assert peer.call(ChangeState, "/estimator/change_state", transition=wish).success
        peer.spin_until(lambda: not worker_of(node.pid), "the worker is gone")
        seen.append((*resources(node.pid), resident_mb(node.pid)))
    threads, files, below, memory = zip(*seen[5:], strict=True)
    assert max(threads) <= threads[0] + 1
    assert max(files) <= files[0] + 2
    assert max(below) == below[0]
    assert memory[-1] < memory[0] + 10


def test_worker_killed_many_times(peer: Peer, processes: Processes) -> None:
    node = processes.start_fake("Recorder")
    peer.connect()
    peer.publish_camera()
    now = 1000
    for _ in range(KILLS):
        peer.spin_until(lambda: len(worker_of(node.pid)) == 1, "a worker")
        os.kill(worker_of(node.pid)[0], signal.SIGKILL)
        count = len(peer.twists)
        while len(peer.twists) == count:
            now += 5
            peer.publish_events(now * MS)
            peer.spin_for(0.02)
    peer.spin_until(lambda: peer.status().get("worker_restarts") == str(KILLS), "the count")


def test_overload_for_minutes_keeps_latency_and_memory(peer: Peer, processes: Processes) -> None:
    node = processes.start_fake("Slow", "-p", "input.queue_windows:=4")
    peer.connect()
    peer.publish_camera()
    memory = []
    for window in range(OVERLOAD_WINDOWS):
        for t in (0, 5):
            peer.publish_events((1000 + 10 * window + t) * MS, count=200)
        peer.spin_for(0.01)
        if window % 1000 == 999:
            memory.append(resident_mb(node.pid))
            assert float(peer.status()["latency_p95_ms"]) < (4 + 2) * 50 + 100
    peer.spin_for(1.0)
    assert int(peer.status()["windows_dropped"]) > OVERLOAD_WINDOWS / 2
    assert memory[-1] < memory[len(memory) // 4] + 10
    dropped = peer.status()["windows_dropped"]
    last = len(peer.twists)
    start = 1000 + 10 * OVERLOAD_WINDOWS + 1000
    for t in range(start, start + 31, 5):
        peer.publish_events(t * MS)
        peer.spin_for(0.1)
    peer.spin_until(lambda: len(peer.twists) >= last + 2, "recovery")
    assert peer.status()["windows_dropped"] == dropped
