"""What benchmarks/node.py measures: a recording replayed through the running node, observed."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psutil
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import try_shutdown
from std_msgs.msg import Header

from benchmarks._event_loop import EVENTS, MARKS
from benchmarks._node_figures import MACHINE, Observed, Sample
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError

DOMAIN = "87"

_DEPTH = 1000
_SAMPLE_S = 0.5
_QUIET_S = 3.0  # diagnostics come once a second
_COUNTED = ("events", "windows")
_WAIT_S = 180.0  # the first start on a machine compiles
_STOP_S = 5.0


def sample_process(role: str, pid: int) -> Sample:
    """Look at a process.

    Raises:
        InputError: it has ended.
    """
    try:
        process = psutil.Process(pid)
        memory, used = process.memory_info(), process.cpu_times()
    except psutil.NoSuchProcess:
        raise InputError(role, "ended during the run", "see its message above") from None
    return Sample(time.time(), memory.rss / 1e6, used.user + used.system)


def sample_cores() -> Sample:
    """Look at all processes on the cores that this one may use."""
    times = psutil.cpu_times(percpu=True)
    busy = sum(
        sum(times[core]) - times[core].idle - times[core].iowait for core in os.sched_getaffinity(0)
    )
    return Sample(time.time(), psutil.virtual_memory().used / 1e6, busy)


class Observer(Node):
    """Fills `observed`; does not read the events, which would cost as much as the node's part."""

    def __init__(self) -> None:
        super().__init__("benchmark")
        self.observed = Observed()
        listen = self.create_subscription
        self.twists: Subscription = listen(
            TwistStamped, "/egomotion/twist", self._take_twist, _DEPTH
        )
        listen(
            TwistWithCovarianceStamped,
            "/egomotion/twist_with_covariance",
            self._take_with_covariance,
            _DEPTH,
        )
        listen(DiagnosticStatus, "/egomotion/status", self._take_status, _DEPTH)
        listen(DiagnosticArray, "/diagnostics", self._take_diagnostics, _DEPTH)
        listen(Header, MARKS, self._take_mark, _DEPTH)

    def quiet_for(self, seconds: float) -> Callable[[], bool]:
        """Return what says whether nothing of windows and counts has changed for so long."""
        before: tuple[Any, ...] = ()
        since = time.monotonic()

        def is_quiet() -> bool:
            nonlocal before, since
            counted = {name: self.observed.diagnostics.get(name) for name in _COUNTED}
            now = (len(self.observed.statuses), counted)
            if now != before:
                before, since = now, time.monotonic()
            return time.monotonic() - since > seconds

        return is_quiet

    def watch_processes(self, pids: Mapping[str, int]) -> None:
        """Sample processes, given by role, and the cores from now on."""
        samples = self.observed.samples
        samples.update({role: [] for role in (*pids, MACHINE)})

        def sample() -> None:
            for role, pid in pids.items():
                samples[role].append(sample_process(role, pid))
            samples[MACHINE].append(sample_cores())

        self._sampling = self.create_timer(_SAMPLE_S, sample)

    def watch_processes_no_longer(self) -> None:
        """End the sampling."""
        self.destroy_timer(self._sampling)

    def _take_twist(self, message: TwistStamped, info: Mapping[str, int]) -> None:
        self.observed.twists.append((_ns(message.header), info["source_timestamp"] / NS_PER_S))

    def _take_with_covariance(self, _: TwistWithCovarianceStamped) -> None:
        self.observed.with_covariance += 1

    def _take_status(self, message: DiagnosticStatus) -> None:
        [status] = [v.value for v in message.values if v.key == "status"]
        self.observed.statuses.append(status)

    def _take_mark(self, message: Header, info: Mapping[str, int]) -> None:
        self.observed.marks.append((_ns(message), info["source_timestamp"] / NS_PER_S))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        self.observed.diagnostics = {v.key: v.value for v in message.status[0].values}


def _ns(header: Header) -> int:
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


def replay_through_node(bag: Path, rate: float) -> Observed:
    """Run the node and `replay` until all twists have come, as `listen_to_replay` does."""
    return listen_to_replay(bag, rate, Observer).observed


def listen_to_replay[T: Observer](
    bag: Path, rate: float, make: Callable[[], T], arguments: Sequence[str] = ()
) -> T:
    """Run the node with arguments and `replay` until all twists have come.

    Args:
        bag: with events, calibration and marks on the topics of _event_loop.
        rate: of the replay.
        make: makes who listens.
        arguments: of the node.

    Raises:
        InputError: a process ended too early, or the node did not listen in time.
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        observer = make()
        observed = observer.observed
        started = time.monotonic()
        with _running("estimator", *arguments) as node:
            _spin_until(observer.twists.get_publisher_count, observer, node)
            with _running(
                "replay", str(bag), "--rate", f"{rate}", "--wait", f"{_WAIT_S}"
            ) as replay:
                _spin_until(lambda: observer.count_subscribers(EVENTS), observer, node, replay)
                observed.listening_s = time.monotonic() - started
                observer.watch_processes(_pids(node.pid) | {"replay": replay.pid})
                while replay.poll() is None:
                    rclpy.spin_once(observer, timeout_sec=0.1)
                observer.watch_processes_no_longer()
                if replay.returncode:
                    raise InputError(
                        "replay", f"exit code {replay.returncode}", "see its message above"
                    )
            _spin_until(observer.quiet_for(_QUIET_S), observer, node)
        return observer
    finally:
        try_shutdown()


def _spin_until(
    condition: Callable[[], Any], observer: Observer, *processes: subprocess.Popen[bytes]
) -> None:
    deadline = time.monotonic() + _WAIT_S
    while not condition():
        for process in processes:
            if process.poll() is not None:
                raise InputError(
                    Path(process.args[0]).name, "ended too early", "see its message above"
                )
        if time.monotonic() > deadline:
            raise InputError("estimator", f"silent for {_WAIT_S:g} s", "see its messages above")
        rclpy.spin_once(observer, timeout_sec=0.02)


@contextmanager
def _running(name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run an executable of the package as `ros2 run` does."""
    try:
        path = f"{get_package_prefix('emoflow_ros')}/lib/emoflow_ros/{name}"
    except PackageNotFoundError:
        raise InputError("emoflow_ros", "not installed", "source scripts/env.sh") from None
    process = subprocess.Popen([path, *arguments], start_new_session=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)  # nothing happens if it has ended
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()


def _pids(node: int) -> dict[str, int]:
    """Find the node's processes: the worker is its only grandchild, the server between them."""
    children = psutil.Process(node).children()
    [(server, worker)] = [(child, below) for child in children for below in child.children()]
    pids = {"node": node, "worker": worker.pid, "server": server.pid}
    return pids | {"benchmark": os.getpid()}
