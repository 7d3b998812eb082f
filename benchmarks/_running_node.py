"""What benchmarks/node.py measures: a recording replayed through the running node, observed."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.utilities import try_shutdown

from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Events, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.node.topic_search import import_message_type
from emoflow_ros.simulation.messages import CAMERA_INFO, EVENT_ARRAY, MessageEncoder
from emoflow_ros.simulation.recording import SimulatedRecording
from emoflow_ros.simulation.recording_files import Topic
from msg_adapters import make_decoder

START = 1_500_000_000 * NS_PER_S
BATCH = 10 * NS_PER_MS
CAMERA_INFO_PERIOD = 50 * NS_PER_MS
LEAD_IN = 2 * NS_PER_S  # calibration alone, so that the observer, too, hears the first events
EVENTS = "/davis/left/events"
DOMAIN = "87"
SAMPLE_S = 1.0
QUIET_S = 3.0  # for the windows that wait, and the diagnostics after them
WAIT_S = 180.0  # the first start on a machine compiles
STOP_S = 5.0


class RepeatedRecording:
    """A recording over and over, each time later by its length, in batches of 10 ms.

    Args:
        recording: what is repeated.
        duration_s: of the whole.
    """

    def __init__(self, recording: SimulatedRecording, duration_s: float) -> None:
        self._recording = recording
        self._length = (recording.t_end - recording.t_start) // BATCH * BATCH
        self._end = recording.t_start + round(duration_s * NS_PER_S)

    @property
    def batch_ends(self) -> range:
        """Times (ns) at which a batch ends and is published."""
        return range(self._recording.t_start + BATCH, self._end + 1, BATCH)

    def batch(self, end: int) -> Events:
        """Return the events of the 10 ms before `end`."""
        events = self._recording.events
        begin = end - BATCH
        shift = (begin - self._recording.t_start) // self._length * self._length
        first, last = np.searchsorted(events.t, [begin - shift, end - shift])
        part = events[first:last]
        return Events(part.x, part.y, part.t + shift, part.p)

    def topics(self, encoder: MessageEncoder) -> list[Topic]:
        """List what the node needs: events and calibration."""
        camera = self._recording.camera
        infos = range(self._recording.t_start - LEAD_IN, self._end, CAMERA_INFO_PERIOD)

        def encode_events(end: int) -> bytes:
            return encoder.events(end - BATCH, camera, self.batch(end))

        return [
            Topic(EVENTS, EVENT_ARRAY, self.batch_ends, encode_events),
            Topic(
                EVENTS.replace("events", "camera_info"),
                CAMERA_INFO,
                infos,
                lambda t: encoder.camera_info(t, camera),
            ),
        ]

    def windows(self, policy: WindowPolicy) -> dict[int, int]:
        """Return the time of each window's last event by the window's end, ns."""
        slicer = WindowSlicer(policy)
        return {
            window.t_end: int(window.events.t[-1])
            for end in self.batch_ends
            for window in slicer.push(self.batch(end))
        }


@dataclass(frozen=True)
class Sample:
    """What a process holds and has used.

    Attributes:
        time: Unix time, s.
        resident_mb: memory, MB (10^6 bytes).
        cpu_s: user and system time since its start.
    """

    time: float
    resident_mb: float
    cpu_s: float

    @classmethod
    def of(cls, role: str, pid: int) -> "Sample":
        """Look at a process.

        Raises:
            InputError: it has ended.
        """
        try:
            process = psutil.Process(pid)
            memory, used = process.memory_info(), process.cpu_times()
        except psutil.NoSuchProcess:
            raise InputError(role, "ended during the run", "see its message above") from None
        return cls(time.time(), memory.rss / 1e6, used.user + used.system)


@dataclass
class Observed:
    """What came over DDS, in Unix time, and what the processes used.

    Attributes:
        publications: (time of the message's last event in ns, publication in s).
        twists: reception in s by stamp in ns.
        diagnostics: the node's last numbers.
        listening_s: from the start of the node's process to its subscription.
        samples: by role, one each SAMPLE_S of the replay.
    """

    publications: list[tuple[int, float]] = field(default_factory=list)
    twists: dict[int, float] = field(default_factory=dict)
    diagnostics: dict[str, str] = field(default_factory=dict)
    listening_s: float = float("nan")
    samples: dict[str, list[Sample]] = field(default_factory=dict)


class Observer(Node):
    """Fills `observed`."""

    def __init__(self) -> None:
        super().__init__("benchmark")
        self.observed = Observed()
        self._decoder = make_decoder(EVENT_ARRAY, "cdr")
        self.twists: Subscription = self.create_subscription(
            TwistStamped, "/egomotion/twist", self._take_twist, 1000
        )
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 10)

    def watch_events(self) -> None:
        """Subscribe to the events, too: only after the node, for which `replay` waits."""
        message_type = import_message_type(EVENT_ARRAY)
        self.create_subscription(message_type, EVENTS, self._take_events, 1000, raw=True)

    def watch_processes(self, pids: Mapping[str, int]) -> None:
        """Sample processes, given by role, from now on."""
        samples = self.observed.samples
        samples.update({role: [] for role in pids})

        def sample() -> None:
            for role, pid in pids.items():
                samples[role].append(Sample.of(role, pid))

        self._sampling = self.create_timer(SAMPLE_S, sample)

    def watch_processes_no_longer(self) -> None:
        """End the sampling."""
        self.destroy_timer(self._sampling)

    def _take_twist(self, message: TwistStamped, info: Mapping[str, int]) -> None:
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        self.observed.twists[stamp] = info["received_timestamp"] / NS_PER_S

    def _take_events(self, data: bytes, info: Mapping[str, int]) -> None:
        events = self._decoder.decode(data).events
        if len(events):
            published = info["source_timestamp"] / NS_PER_S
            self.observed.publications.append((int(events.t[-1]), published))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        self.observed.diagnostics = {v.key: v.value for v in message.status[0].values}


def replay_through_node(bag: Path, rate: float) -> Observed:
    """Run the node and `replay` until all twists have come.

    Raises:
        InputError: a process ended too early, or the node did not listen in time.
    """
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        observer = Observer()
        observed = observer.observed
        started = time.monotonic()
        with _running("estimator") as node:
            _spin_until(observer.twists.get_publisher_count, observer, node)
            with _running("replay", str(bag), "--rate", f"{rate}", "--wait", f"{WAIT_S}") as replay:
                _spin_until(lambda: observer.count_subscribers(EVENTS), observer, node, replay)
                observed.listening_s = time.monotonic() - started
                observer.watch_events()
                observer.watch_processes(_pids(node.pid) | {"replay": replay.pid})
                while replay.poll() is None:
                    rclpy.spin_once(observer, timeout_sec=0.1)
                observer.watch_processes_no_longer()
                if replay.returncode:
                    raise InputError(
                        "replay", f"exit code {replay.returncode}", "see its message above"
                    )
            ended = time.monotonic()
            _spin_until(lambda: time.monotonic() - ended > QUIET_S, observer, node)
        return observed
    finally:
        try_shutdown()


def _spin_until(
    condition: Callable[[], Any], observer: Observer, *processes: subprocess.Popen[bytes]
) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        for process in processes:
            if process.poll() is not None:
                raise InputError(
                    Path(process.args[0]).name, "ended too early", "see its message above"
                )
        if time.monotonic() > deadline:
            raise InputError("estimator", f"silent for {WAIT_S:g} s", "see its messages above")
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
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()


def _pids(node: int) -> dict[str, int]:
    """Find the node's processes: the worker is its only grandchild, the server between them."""
    children = psutil.Process(node).children()
    [(server, worker)] = [(child, below) for child in children for below in child.children()]
    pids = {"node": node, "worker": worker.pid, "server": server.pid}
    return pids | {"benchmark": os.getpid()}
