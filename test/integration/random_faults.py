"""A node under a seeded script of faults and changes."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from accounted_stream import DIED, AccountedStream
from harness import CAMERA, MS, Peer, Processes
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription
from sensor_msgs.msg import Image

from emoflow_ros.core.geometry.camera import Camera

LARGE = Camera(96, 72, 75.0, 75.0, 48.0, 36.0)
DURATIONS_MS = (60.0, 30.0, 90.0)  # of windows; the first one at the start
PARAMETERS = (
    f"window.duration_ms:={DURATIONS_MS[0]}",
    "window.stride_ms:=0.0",
    "window.max_displacement_px:=0.0",  # so that the stamps of windows are known here
    "input.timestamps:=sensor",
    "output.diagnostics_s:=0.2",
    "input.queue_windows:=40",  # no message is left out, also on a busy machine
    "output.timeout_s:=600.0",  # a stopped worker is not replaced, also on a busy machine
)
_BUSY = "while True: pass"
_SLOW_SUBSCRIBER = """
import rclpy
from geometry_msgs.msg import TwistStamped
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("slow")
qos = QoSProfile(history=HistoryPolicy.KEEP_ALL)
node.create_subscription(TwistStamped, "/egomotion/twist", lambda twist: None, qos)
node.create_subscription(Image, "/flow/color", lambda image: None, qos)
rclpy.spin(node)
"""
_LINES = (DIED, "event time went .*: the estimation starts anew")


class Script(AccountedStream):
    """Does what may happen to a node, one thing after another, while events stream.

    Args:
        peer: publishes `/events`, reliably.
        processes, node: the node, with PARAMETERS.
        seed: of what happens, and when.

    Attributes:
        done: how often each thing was done.
    """

    def __init__(self, peer: Peer, processes: Processes, node: int, seed: int) -> None:
        super().__init__(peer, node, DURATIONS_MS[0])
        self.done: Counter[str] = Counter()
        self._processes = processes
        self._log = processes.started[-1]
        self._random = random.Random(seed)
        self._longest = 0.1  # seconds of streaming, and of a pause
        self._pictures: Subscription | None = None
        self._slow: subprocess.Popen[bytes] | None = None  # the slow subscriber

    def run(self, seconds: float) -> None:
        """Do things for so many seconds, each at least once."""
        actions = (
            self.kill_worker, self.stop_worker, self.stop_node, self.pause, self.change_scale,
            self.change_windows, self.change_pictures, self.change_calibration,
            self.change_sensor, self.jump_back, self.jump_ahead, self.activate_again,
            self.load_all_cores, self.subscribe_slowly,
        )  # fmt: skip
        self._peer.publish_camera(self._camera)
        self._hear_calibration(0)
        self._slow = self._processes.start(sys.executable, "-c", _SLOW_SUBSCRIBER)
        self._peer.spin_until(
            lambda: self._peer.node.count_subscribers("/flow/color"), "the slow subscriber"
        )
        self.stream_until_right("start")
        self._longest = min(2.5, seconds / 10)
        end = time.monotonic() + seconds
        while not self.figures.uses or time.monotonic() < end:
            for action in self._random.sample(actions, len(actions)):
                self.stream(self._random.uniform(0.05, self._longest))
                action()
                self.stream_until_right(action.__name__)
                self.done[action.__name__] += 1
            self.account()
        self._slow.send_signal(signal.SIGINT)
        self._slow.wait()

    def kill_worker(self) -> None:
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        [worker] = self._workers()
        os.kill(worker, signal.SIGKILL)
        # What comes next must not take it for its successor.
        self._peer.spin_until(lambda: worker not in self._workers(), "its end")

    def stop_worker(self) -> None:
        """Stop it for longer than short windows can wait, and let it go on."""
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        with _stopped(self._workers()[0]):
            self.stream(0.6)

    def stop_node(self) -> None:
        """Stop it as a busy machine might, while its messages wait."""
        with _stopped(self._node):
            self.stream(self._random.uniform(0.05, 0.3))

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
        self._duration_ms = self._random.choice([d for d in DURATIONS_MS if d != old])
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
        self._camera = CAMERA if self._camera.width == LARGE.width else LARGE
        self._peer.publish_camera(self._camera)
        self._hear_calibration(heard)
        self._slicer = self._make_slicer()

    def jump_back(self) -> None:
        """Jump while windows are in work and wait, which are then forgotten."""
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        with _stopped(self._workers()[0]):
            self.stream(0.1)
            self._jump(-self._random.uniform(200, 60_000))

    def jump_ahead(self) -> None:
        self._jump(self._random.uniform(11_000, 60_000))

    def activate_again(self) -> None:
        """Deactivate the node while windows are in work and wait, and activate it."""
        events = self._peer.events
        self._peer.spin_until(lambda: len(self._workers()) == 1, "a worker")
        with _stopped(self._workers()[0]):
            self.stream(0.1)
            self._wait_until_heard()
            self._change(Transition.TRANSITION_DEACTIVATE)
        self._peer.spin_until(lambda: not events.get_subscription_count(), "it listens no more")
        self._change(Transition.TRANSITION_ACTIVATE)
        self._peer.spin_until(events.get_subscription_count, "it listens again")
        self._peer.spin_for(0.3)  # until it knows, too, that it is heard
        self._start_epoch(self._now)

    def load_all_cores(self) -> None:
        """Let other processes take all cores, and end them."""
        cores = os.sched_getaffinity(0)
        busy = [self._processes.start(sys.executable, "-c", _BUSY) for _ in cores]
        self.stream(self._random.uniform(0.05, self._longest))
        for process in busy:
            process.kill()
            process.wait()
            self._processes.started.remove(process)

    def subscribe_slowly(self) -> None:
        """Let a subscriber, which keeps all, read nothing for some time."""
        assert self._slow is not None
        with _stopped(self._slow.pid):
            self.stream(self._random.uniform(0.05, self._longest))

    def unexplained(self) -> list[str]:
        """Lines of the node's log that nothing of what was done explains."""
        lines = self._processes.output(self._log).splitlines()
        bad = [line for line in lines if not line.startswith("[INFO]")]
        return [line for line in bad if not any(re.search(known, line) for known in _LINES)]

    def _jump(self, milliseconds: float) -> None:
        self._start_epoch(self._now + round(milliseconds) * MS)
        self.stream(0.1)

    def _calibrations(self) -> int:
        return self._processes.output(self._log).count("calibration: ")

    def _hear_calibration(self, before: int) -> None:
        self._peer.spin_until(lambda: self._calibrations() > before, "the calibration")

    def _set(self, values: dict[str, str | float]) -> None:
        wish = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        answer = self._peer.call(SetParameters, "/estimator/set_parameters", parameters=wish)
        assert all(result.successful for result in answer.results)

    def _change(self, transition: int) -> None:
        wish = Transition(id=transition)
        assert self._peer.call(ChangeState, "/estimator/change_state", transition=wish).success


@contextmanager
def _stopped(process: int) -> Iterator[None]:
    """Stop a process meanwhile."""
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(process, signal.SIGCONT)
