"""Faults many times over: a few times in `make test`, for minutes in `make soak`."""

import os
import signal
import time

import psutil
import pytest
from geometry_msgs.msg import TwistStamped
from harness import CAMERA, MS, Peer, Processes, children
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from shared_node import SharedNode

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.node.diagnostics import resident_mb

pytestmark = pytest.mark.dds

# 10 ms of events each, five times what is possible: 10 minutes of them, and 5 s.
OVERLOAD_WINDOWS = 60_000
FEW_WINDOWS = 500
SMALL = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)


def few_and_many(few: int, many: int) -> list[object]:
    return [few, pytest.param(many, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]


def worker_of(pid: int) -> list[int]:
    return [worker for child in children(pid) for worker in children(child)]


def outputs_of(peer: Peer) -> list[str]:
    """Topics of a configured node that somebody still publishes; diagnostics come always."""
    names = [name for name, _ in peer.node.get_topic_names_and_types()]
    ours = [n for n in names if n.startswith(("/egomotion/", "/flow/"))]
    return [name for name in ours if peer.node.count_publishers(name)]


def resources(pid: int) -> tuple[int, int, int]:
    """Count the threads, open files and processes below."""
    process = psutil.Process(pid)
    return process.num_threads(), process.num_fds(), len(children(pid)) + len(worker_of(pid))


@pytest.mark.parametrize("times", few_and_many(10, 50))
def test_lifecycles_leak_nothing(peer: Peer, processes: Processes, times: int) -> None:
    node = processes.start_fake("Recorder", "-p", "autostart:=false")
    seen = []
    for _ in range(times):
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
    threads, files, below, memory = zip(*seen[times // 2 :], strict=True)
    assert max(threads) <= threads[0] + 1
    assert max(files) <= files[0] + 2
    assert max(below) == below[0]
    assert memory[-1] < memory[0] + 10
    peer.spin_until(lambda: not outputs_of(peer), "no topic is left")


@pytest.mark.parametrize("times", few_and_many(3, 20))
def test_worker_killed_many_times(peer: Peer, recorder: SharedNode, times: int) -> None:
    recorder.start(peer)
    peer.connect()
    peer.publish_camera()
    now = 1000
    for _ in range(times):
        peer.spin_until(lambda: len(worker_of(recorder.pid)) == 1, "a worker")
        os.kill(worker_of(recorder.pid)[0], signal.SIGKILL)
        count = len(peer.twists)
        while len(peer.twists) == count:
            now += 5
            peer.publish_events(now * MS)
            peer.spin_for(0.02)
    peer.spin_until(lambda: peer.status()["worker_restarts"] == str(times), "the count")


@pytest.mark.parametrize("windows", few_and_many(FEW_WINDOWS, OVERLOAD_WINDOWS))
def test_overload_keeps_latency_and_memory(peer: Peer, processes: Processes, windows: int) -> None:
    node = processes.start_fake("Slow", "-p", "input.queue_windows:=4")
    peer.connect()
    peer.publish_camera()
    memory = []
    started = time.monotonic()
    for window in range(windows):
        for t in (0, 5):
            peer.publish_events((1000 + 10 * window + t) * MS, count=200)
        peer.spin_for(max(0.0, started + 0.01 * window - time.monotonic()))
        if window % 100 == 99:
            memory.append(resident_mb(node.pid))
            peer.spin_until(lambda: "latency_p95_ms" in peer.status(), "a latency")
            assert float(peer.status()["latency_p95_ms"]) < 1000  # 4 wait, 50 ms each
    peer.spin_for(1.0)
    assert int(peer.status()["windows_dropped"]) > windows / 2
    assert int(peer.status()["events_dropped"]) > 400 * windows / 2
    assert memory[-1] < memory[len(memory) // 4] + 10

    # Afterwards windows come one at a time, and each is estimated.
    dropped = peer.status()["windows_dropped"]
    last = len(peer.twists)
    start = 1000 + 10 * windows + 1000
    for t in range(start, start + 31, 5):
        peer.publish_events(t * MS)
        peer.spin_for(0.1)
    peer.spin_until(lambda: len(peer.twists) >= last + 2, "recovery within two windows")
    assert peer.status()["windows_dropped"] == dropped


@pytest.mark.parametrize("seconds", few_and_many(4, 600))
def test_two_nodes_in_namespaces_do_not_mix(processes: Processes, seconds: int) -> None:
    """Two cameras at once, of two sizes, with windows of 10 ms for as long as they last."""
    cameras = {"left": CAMERA, "right": SMALL}
    first = {"left": 1000, "right": 9_000_000}  # ms
    with Peer("/left/events") as left, Peer("/right/events") as right:
        peers = {"left": left, "right": right}
        received: dict[str, list[TwistStamped]] = {name: [] for name in peers}
        for name, peer in peers.items():
            peer.node.create_subscription(
                TwistStamped, f"/{name}/egomotion/twist", received[name].append, 1000
            )
            processes.start_fake(
                "Recorder", "-r", f"__ns:=/{name}", "-p", "input.timestamps:=sensor",
                "-p", "input.queue_windows:=100",  # the machine may be busy
            )  # fmt: skip
        for name, peer in peers.items():
            peer.connect()
            peer.publish_camera(cameras[name])
            peer.spin_until(
                lambda who=f"/{name}/estimator: estimator", at=peer: (
                    who in {d.status[0].name for d in at.diagnostics}
                ),
                "this node is heard",
            )
        started = time.monotonic()
        for t in range(0, 1000 * seconds + 11, 5):
            for name, peer in peers.items():
                peer.publish_events((first[name] + t) * MS, camera=cameras[name])
                # After a stall no burst, which would overflow the subscription's history.
                peer.spin_for(max(0.002, started + t / 1000 - time.monotonic()))
        windows = 100 * seconds + 1
        for name, peer in peers.items():
            peer.spin_until(lambda own=received[name]: len(own) >= windows, f"all of {name}")
            stamps = [
                t.header.stamp.sec * 1000 + t.header.stamp.nanosec // MS for t in received[name]
            ]
            assert stamps == [first[name] + 10 * window + 5 for window in range(windows)]
            assert {t.twist.angular.z for t in received[name]} == {float(cameras[name].width)}
