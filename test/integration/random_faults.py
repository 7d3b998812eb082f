"""A node under a seeded script of faults and changes, and the accounts of its windows."""

import os
import random
import re
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
from diagnostic_msgs.msg import DiagnosticStatus
from harness import CAMERA, MS, Peer, Processes, children
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events, WindowPolicy, WindowSlicer
from emoflow_ros.node.diagnostics import resident_mb

STEP_MS = 5  # between two messages, of 5 events each
SMALL = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
PARAMETERS = (
    "window.duration_ms:=20.0",
    "input.timestamps:=sensor",
    "output.diagnostics_s:=0.2",
    "input.queue_windows:=40",  # no message is left out, also on a busy machine
    "output.timeout_s:=60.0",  # a stopped worker is not replaced, also on a busy machine
)
# Middles of windows differ by whole ms within an epoch, and by this from those of others.
_PHASE_NS = 100
_DIED = r"the worker died \(signal 9\); it is started again"
_REASONS = {
    "ok": "ok(, wide: start)?",  # a new worker starts cold
    "failed": _DIED,
    "dropped": rf"dropped: ({_DIED}|the estimation is slower than the events; give .*)",
}
_LINES = (_DIED, "event time went .*: the estimation starts anew")


class Script:
    """Publishes events at the rate that they have, and in between does what may happen to a node.

    It cuts the events into windows, too, so that it knows each that the node must account for.

    Args:
        peer: publishes `/events`, reliably.
        processes, node: the node, with the estimator `Recorder` and PARAMETERS.
        seed: of what happens, and when.

    Attributes:
        done: how often each thing was done.
        cut: middles of the windows that the events give, ns.
        verdicts: what the node said of each.
        used: threads, files, processes, shared memory and MB of the node, at every account.
    """

    def __init__(self, peer: Peer, processes: Processes, node: int, seed: int) -> None:
        self.done: Counter[str] = Counter()
        self.cut: set[int] = set()
        self.verdicts: dict[int, str] = {}
        self.used: list[tuple[int, int, int, int, float]] = []
        self._peer = peer
        self._processes = processes
        self._node = node
        self._random = random.Random(seed)
        self._camera = CAMERA
        self._duration_ms = 20.0
        self._epoch = 0
        self._sent = 0
        self._longest = 0.1  # seconds of streaming, and of a pause
        self._estimated: set[int] = set()  # middles of the twists until the last account
        self._pictures: Subscription | None = None
        peer.node.create_subscription(
            DiagnosticStatus, "/egomotion/status", self._take, QoSProfile(depth=1000)
        )
        self._start_epoch(10_000_000 * MS)  # far from 0, for all the jumps back

    def run(self, seconds: float) -> None:
        """Do things for so many seconds, each at least once."""
        actions = (
            self.kill_worker, self.stop_worker, self.pause, self.change_scale,
            self.change_windows, self.change_pictures, self.change_calibration,
            self.change_sensor, self.jump_back, self.jump_ahead, self.activate_again,
        )  # fmt: skip
        self._peer.publish_camera(self._camera)
        self._hear_calibration(0)
        self.stream(0.2)
        self._longest = min(2.5, seconds / 10)
        end = time.monotonic() + seconds
        while not self.used or time.monotonic() < end:
            for action in self._random.sample(actions, len(actions)):
                self.stream(self._random.uniform(0.05, self._longest))
                action()
                self.done[action.__name__] += 1
            self.account()

    def stream(self, seconds: float) -> None:
        """Publish the events of so much time in as much time."""
        for _ in range(round(1e3 * seconds / STEP_MS)):
            self._peer.publish_events(self._now, camera=self._camera)
            zeros = np.zeros(5, np.uint16)
            times = self._now + 1000 * np.arange(5, dtype=np.int64)
            for window in self._slicer.push(Events(zeros, zeros, times, zeros.astype(bool))):
                middle = (window.t_start + window.t_end) // 2
                assert middle not in self.cut
                self.cut.add(middle)
            self._sent += 1
            self._now += STEP_MS * MS
            self._peer.spin_for(STEP_MS / 1e3)

    def account(self) -> None:
        """Wait for the last window; all of them must be accounted for, each once."""
        self._wait_until_heard()
        self._peer.spin_until(lambda: self._count("windows") == len(self.cut), "all windows")
        names = ("ok", "failed", "dropped", "forgotten")

        def counts() -> dict[str, int]:
            return {name: self._count(f"windows_{name}") for name in names}

        self._peer.spin_until(lambda: sum(counts().values()) == len(self.cut), "their fate")
        count = counts()
        forgotten = count.pop("forgotten")
        expected = len(self.cut) - forgotten
        self._peer.spin_until(lambda: len(self.verdicts) == expected, "their status")
        assert self.verdicts.keys() <= self.cut
        assert Counter(self.verdicts.values()) == Counter(count)
        twists = self._peer.twists
        missing = count["ok"] - len(self._estimated)
        self._peer.spin_until(lambda: len(twists) >= missing, "their twists")
        self._estimated |= {t.header.stamp.sec * 10**9 + t.header.stamp.nanosec for t in twists}
        assert len(twists) == missing
        assert self._estimated == {m for m, verdict in self.verdicts.items() if verdict == "ok"}
        lost = ("malformed_messages", "seq_gaps", "messages_skipped", "windows_diverged")
        for name in ("internal_errors", *lost):
            assert self._count(name) == 0
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        self.used.append(self._resources())
        for messages in (self._peer.twists, self._peer.covariances, self._peer.images):
            messages.clear()
        del self._peer.diagnostics[:-1]

    def kill_worker(self) -> None:
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        [worker] = self._workers()
        os.kill(worker, signal.SIGKILL)
        # What comes next must not take it for its successor.
        self._peer.spin_until(lambda: worker not in self._workers(), "its end")

    def stop_worker(self) -> None:
        """Stop it for longer than short windows can wait, and let it go on."""
        with self._stopped_worker():
            self.stream(0.6)

    def pause(self) -> None:
        """Send nothing, like a camera at rest; event time goes on."""
        seconds = self._random.uniform(0.1, self._longest)
        self._peer.spin_for(seconds)
        self._now += round(seconds * 1000) * MS

    def change_scale(self) -> None:
        source = self._random.choice(["none", "parameter"])
        self._set({"scale.source": source, "scale.speed": self._random.uniform(0.1, 9.0)})

    def change_windows(self) -> None:
        """Cut differently; that begins with the next event, as it does in the node."""
        self._wait_until_heard()
        old = self._duration_ms
        self._duration_ms = self._random.choice([d for d in (10.0, 20.0, 40.0) if d != old])
        self._set({"window.duration_ms": self._duration_ms})
        self._slicer = self._make_slicer()

    def change_pictures(self) -> None:
        """Subscribe to the flow, or do so no longer."""
        if self._pictures is None:
            self._pictures = self._peer.node.create_subscription(
                Image, "/flow/image", self._peer.images.append, 10
            )
        else:
            self._peer.node.destroy_subscription(self._pictures)
            self._pictures = None

    def change_calibration(self) -> None:
        """Change the focal length, in the middle of a window."""
        self._camera = replace(self._camera, fx=self._random.uniform(20.0, 90.0))
        self._peer.publish_camera(self._camera)

    def change_sensor(self) -> None:
        """Go on with a sensor of another size; the unfinished window is left out."""
        self._wait_until_heard()
        heard = self._calibrations()
        self._camera = CAMERA if self._camera.width == SMALL.width else SMALL
        self._peer.publish_camera(self._camera)
        self._hear_calibration(heard)
        self._slicer = self._make_slicer()

    def jump_back(self) -> None:
        """Jump while windows are in work and wait, which are then forgotten."""
        with self._stopped_worker():
            self.stream(0.1)
            self._jump(-self._random.uniform(200, 60_000))

    def jump_ahead(self) -> None:
        self._jump(self._random.uniform(11_000, 60_000))

    def activate_again(self) -> None:
        """Deactivate the node while windows are in work and wait, and activate it."""
        events = self._peer.events
        with self._stopped_worker():
            self.stream(0.1)
            self._wait_until_heard()
            self._change(Transition.TRANSITION_DEACTIVATE)
        self._peer.spin_until(lambda: not events.get_subscription_count(), "it listens no more")
        self._change(Transition.TRANSITION_ACTIVATE)
        self._peer.spin_until(events.get_subscription_count, "it listens again")
        self._peer.spin_for(0.3)  # until it knows, too, that it is heard
        self._start_epoch(self._now)

    def unexplained(self) -> list[str]:
        """Lines of the node's log that nothing of what was done explains."""
        lines = self._processes.output(self._processes.started[-1]).splitlines()
        bad = [line for line in lines if not line.startswith("[INFO]")]
        return [line for line in bad if not any(re.search(known, line) for known in _LINES)]

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
        assert re.fullmatch(_REASONS[verdict], status.message), status.message
        self.verdicts[middle] = verdict

    @contextmanager
    def _stopped_worker(self) -> Iterator[None]:
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        [worker] = self._workers()
        os.kill(worker, signal.SIGSTOP)
        yield
        os.kill(worker, signal.SIGCONT)

    def _jump(self, milliseconds: float) -> None:
        self._start_epoch(self._now + round(milliseconds) * MS)
        self.stream(0.1)

    def _start_epoch(self, t: int) -> None:
        self._epoch += 1
        self._now = t // MS * MS + self._epoch * _PHASE_NS
        self._slicer = self._make_slicer()

    def _make_slicer(self) -> WindowSlicer:
        return WindowSlicer(WindowPolicy(duration_ms=self._duration_ms))

    def _wait_until_heard(self) -> None:
        self._peer.spin_until(lambda: self._count("messages") == self._sent, "all messages")

    def _count(self, name: str) -> int:
        return int(self._peer.status().get(name, -1))

    def _calibrations(self) -> int:
        return self._processes.output(self._processes.started[-1]).count("calibration: ")

    def _hear_calibration(self, before: int) -> None:
        self._peer.spin_until(lambda: self._calibrations() > before, "the calibration")

    def _set(self, values: dict[str, str | float]) -> None:
        wish = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = self._peer.call(SetParameters, "/estimator/set_parameters", parameters=wish)
        assert all(result.successful for result in answer.results)

    def _change(self, transition: int) -> None:
        wish = Transition(id=transition)
        assert self._peer.call(ChangeState, "/estimator/change_state", transition=wish).success

    def _workers(self) -> list[int]:
        return [worker for child in children(self._node) for worker in children(child)]

    def _resources(self) -> tuple[int, int, int, int, float]:
        process = psutil.Process(self._node)
        threads, files = process.num_threads(), process.num_fds()
        below = len(children(self._node)) + len(self._workers())
        memory = len(self.shared_memory())
        return threads, files, below, memory, resident_mb(self._node)
