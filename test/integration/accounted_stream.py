"""Events for a node, and the accounts of its windows."""

import re
import time
from collections import Counter
from pathlib import Path

import psutil
from diagnostic_msgs.msg import DiagnosticStatus
from fault_figures import Figures, Use
from harness import CAMERA, MS, WAIT_S, Peer, children
from moving_dots import MovingDots
from rclpy.qos import QoSProfile

from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import NS_PER_S, WindowPolicy, WindowSlicer
from emoflow_ros.node.diagnostics import resident_mb
from emoflow_ros.simulation.messages import MessageEncoder

STEP_MS = 5  # between two messages
# Middles of windows differ by whole ms within an epoch, and by this from those of others.
_PHASE_NS = 100
DIED = r"the worker died \(signal 9\); it is started again"
# What the messages of windows begin with.
_REASONS = {
    "failed": rf"{DIED}$",
    "dropped": rf"dropped: ({DIED}$|the estimation is slower than the events; give "
    "|other processes leave the estimation |the worker has been busy with one window for )",
}
_FATES = (*map(str, Status), "failed", "dropped", "forgotten")
_LOST = ("malformed_messages", "seq_gaps", "messages_skipped", "internal_errors")


class AccountedStream:
    """Publishes events at the rate that they have, and accounts for the windows of the node.

    It cuts the events into windows, too, so that it knows each that the node must account for.

    Args:
        peer: publishes `/events`, reliably.
        node: process id.
        duration_ms: of its windows.

    Attributes:
        cut: middles of the windows that the events give, ns.
        verdicts: what the node said of each.
        figures: of the run.
    """

    def __init__(self, peer: Peer, node: int, duration_ms: float) -> None:
        self.cut: set[int] = set()
        self.verdicts: dict[int, str] = {}
        self.figures = Figures()
        self._peer = peer
        self._node = node
        self._duration_ms = duration_ms
        self._camera = CAMERA
        self._dots = MovingDots()
        self._encoder = MessageEncoder(ros1=False)
        self._epoch = 0
        self._sent = 0
        self._told: set[int] = set()  # middles of the twists until the last account
        peer.node.create_subscription(
            DiagnosticStatus, "/egomotion/status", self._take, QoSProfile(depth=1000)
        )
        self._start_epoch(10_000_000 * MS)  # far from 0, for all the jumps back

    def stream(self, seconds: float) -> None:
        """Publish the events of so much time in as much time."""
        for _ in range(round(1e3 * seconds / STEP_MS)):
            due = time.monotonic() + STEP_MS / 1e3
            length = STEP_MS * MS
            events = self._dots.events(self._camera, self._began, self._now, length)
            self._peer.events.publish(self._encoder.events(self._now, self._camera, events))
            for window in self._slicer.push(events):
                middle = (window.t_start + window.t_end) // 2
                assert middle not in self.cut
                self.cut.add(middle)
            self._sent += 1
            self._now += length
            self._peer.spin_for(max(1e-3, due - time.monotonic()))

    def stream_until_right(self, fault: str) -> None:
        """Stream until there is a twist of events from now on, and note how long that took."""
        begin, started = self._now, time.monotonic()
        heard = len(self._peer.twists)
        while not any(self._stamp(twist) >= begin for twist in self._peer.twists[heard:]):
            self.stream(STEP_MS / 1e3)
            assert time.monotonic() - started < WAIT_S, f"no twist since {fault}: {self.fates()}"
        self.figures.right_again[fault].append(time.monotonic() - started)

    def account(self) -> None:
        """Wait for the last window; all of them must be accounted for, each once."""
        self._wait_until_heard()
        self._peer.spin_until(lambda: self._count("windows") == len(self.cut), "all windows")
        self._peer.spin_until(lambda: sum(self.fates().values()) == len(self.cut), "their fate")
        count = self.fates()
        expected = len(self.cut) - count.pop("forgotten")
        self._peer.spin_until(lambda: len(self.verdicts) == expected, "their status")
        assert self.verdicts.keys() <= self.cut
        assert Counter(self.verdicts.values()) == Counter(count)
        told = {m for m, fate in self.verdicts.items() if fate in set(Status) and Status(fate).told}
        twists = self._peer.twists
        missing = len(told) - len(self._told)
        self._peer.spin_until(lambda: len(twists) >= missing, "their twists")
        self._told |= {self._stamp(twist) for twist in twists}
        assert len(twists) == missing
        assert self._told == told
        assert {name: self._count(name) for name in _LOST} == dict.fromkeys(_LOST, 0)
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        self.figures.uses.append(self._use())
        for messages in (self._peer.twists, self._peer.covariances, self._peer.images):
            messages.clear()
        del self._peer.diagnostics[:-1]

    def fates(self) -> dict[str, int]:
        """What the node says became of the windows: how many, by name."""
        return {name: self._count(f"windows_{name}") for name in _FATES}

    def shared_memory(self) -> set[str]:
        """Files of shared memory that the node has mapped, and this process has not."""

        def mapped(pid: int | str) -> set[str]:
            return set(re.findall(r"/dev/shm/\S+", Path(f"/proc/{pid}/maps").read_text()))

        return mapped(self._node) - mapped("self")

    def _take(self, status: DiagnosticStatus) -> None:
        values = {v.key: v.value for v in status.values}
        verdict = values["status"]
        middle = int(values["stamp"].replace(".", ""))
        assert middle not in self.verdicts, f"{middle}: {self.verdicts[middle]} and {verdict}"
        assert re.match(_REASONS.get(verdict, verdict), status.message), status.message
        self.verdicts[middle] = verdict

    @staticmethod
    def _stamp(twist: object) -> int:
        stamp = twist.header.stamp  # type: ignore[attr-defined]
        return int(stamp.sec * NS_PER_S + stamp.nanosec)

    def _start_epoch(self, t: int) -> None:
        self._epoch += 1
        self._began = self._now = t // MS * MS + self._epoch * _PHASE_NS
        self._slicer = self._make_slicer()

    def _make_slicer(self) -> WindowSlicer:
        return WindowSlicer(WindowPolicy(duration_ms=self._duration_ms))

    def _wait_until_heard(self) -> None:
        self._peer.spin_until(lambda: self._count("messages") == self._sent, "all messages")

    def _count(self, name: str) -> int:
        return int(self._peer.status().get(name, -1))

    def _workers(self) -> list[int]:
        return [worker for child in children(self._node) for worker in children(child)]

    def _use(self) -> Use:
        process = psutil.Process(self._node)
        [worker] = self._workers()
        return Use(
            threads=process.num_threads(),
            files=process.num_fds(),
            below=len(children(self._node)) + 1,
            segments=len(self.shared_memory()),
            node_mb=resident_mb(self._node),
            worker_mb=resident_mb(worker),
        )
