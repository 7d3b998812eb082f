"""The other end of the node in tests: processes under test, and a ROS node that talks to them."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from dvs_msgs.msg import EventArray
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import CameraInfo, Image

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.node.supervisor import FACTORY
from emoflow_ros.simulation.messages import MessageEncoder

ROOT = Path(__file__).resolve().parents[2]
CAMERA = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
MS = 1_000_000
WAIT_S = 600.0  # only what hangs takes so long, also on a busy machine

WAITING = "input.queue_windows:=8"
OF_WINDOWS = "output.twist_rate:=0.0"
_AGAIN_S, _CAMERA_INFO_S = 10.0, 0.2  # after which a request, or a calibration, is sent again
_GOALS = {
    Transition.TRANSITION_CONFIGURE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_ACTIVATE: State.PRIMARY_STATE_ACTIVE,
    Transition.TRANSITION_DEACTIVATE: State.PRIMARY_STATE_INACTIVE,
    Transition.TRANSITION_CLEANUP: State.PRIMARY_STATE_UNCONFIGURED,
}
_DRIVER_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)


def wait_for(condition: Callable[[], Any], what: str) -> None:
    deadline = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {WAIT_S} s"
        time.sleep(0.01)


def children(pid: int) -> list[int]:
    """Process ids of the direct children, whichever thread started them."""
    try:
        return [child.pid for child in psutil.Process(pid).children()]
    except psutil.NoSuchProcess:
        return []


class Peer:
    """A node in the test's own process that publishes what a driver would and collects answers.

    Args:
        events_topic: where it publishes events. `/events` is what the node asks for; any other
            it takes only once its graph has been quiet for a second.
        events_type: class of the messages of events.
        reliability: of their publisher.
    """

    def __init__(
        self,
        events_topic: str = "/events",
        events_type: Any = EventArray,
        reliability: ReliabilityPolicy = ReliabilityPolicy.BEST_EFFORT,
    ) -> None:
        self.context = Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("peer", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._encoder = MessageEncoder(ros1=False)
        namespace = events_topic.rpartition("/")[0]
        qos = QoSProfile(depth=_DRIVER_QOS.depth, reliability=reliability)
        self.events = self.node.create_publisher(events_type, events_topic, qos)
        self.camera_info = self.node.create_publisher(
            CameraInfo, f"{namespace}/camera_info", _DRIVER_QOS
        )
        self.twists: list[TwistStamped] = []
        self.covariances: list[TwistWithCovarianceStamped] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.images: list[Image] = []
        self._camera_timer: Timer | None = None
        self._clients: dict[str, Client] = {}
        self._subscribe(TwistStamped, "/egomotion/twist", self.twists)
        self._subscribe(
            TwistWithCovarianceStamped, "/egomotion/twist_with_covariance", self.covariances
        )
        self._hear_diagnostics(self.diagnostics)

    def subscribe_flow(self) -> None:
        self._subscribe(Image, "/flow/image", self.images)

    def _subscribe(self, kind: Any, topic: str, messages: list[Any]) -> None:
        self.node.create_subscription(kind, topic, messages.append, 100)

    def _hear_diagnostics(self, messages: list[DiagnosticArray]) -> Subscription:
        """Hear of nodes that are configured: shared ones of other tests may be there, too."""
        return self.node.create_subscription(
            DiagnosticArray,
            "/diagnostics",
            lambda m: m.status[0].values and messages.append(m),
            100,
        )

    def hear(self) -> None:
        """Wait until everything that the node under test will say arrives here.

        A node learns of this one's subscriptions in the order in which they were made: once it
        is heard by the newest, all the others are known to it.
        """
        heard: list[DiagnosticArray] = []
        newest = self._hear_diagnostics(heard)
        self.spin_until(lambda: heard, "the node is heard")
        self.node.destroy_subscription(newest)

    def spin_until(
        self, condition: Callable[[], Any], what: str, timeout_s: float = WAIT_S
    ) -> None:
        deadline = time.monotonic() + timeout_s
        while not condition():
            seen = f"{len(self.twists)} twists, {len(self.images)} images, {self.status()}"
            assert time.monotonic() < deadline, f"{what}: not within {timeout_s} s; {seen}"
            self._executor.spin_once(timeout_sec=0.05)

    def spin_while_alive(self, condition: Callable[[], Any], beats: int = 10) -> bool:
        """Spin until a condition holds, or the node has reported so many times without it."""
        last = len(self.diagnostics) + beats
        self.spin_until(lambda: condition() or len(self.diagnostics) >= last, "the node's reports")
        return bool(condition())

    def spin_for(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def connect(self) -> None:
        """Wait until the node under test listens and is heard."""
        self.hear()
        self.spin_until(
            lambda: (
                self.events.get_subscription_count() and self.camera_info.get_subscription_count()
            ),
            "the node listens",
        )

    def publish_camera(self, camera: Camera = CAMERA) -> None:
        """Publish a calibration now and, as drivers do, again and again, until the next one."""
        self.publish_camera_info(self._encoder.camera_info(0, camera))

    def publish_camera_info(self, info: CameraInfo | bytes) -> None:
        """Publish a message now and again and again, until the next one."""
        if self._camera_timer is not None:
            self.node.destroy_timer(self._camera_timer)
        self.camera_info.publish(info)
        self._camera_timer = self.node.create_timer(
            _CAMERA_INFO_S, lambda: self.camera_info.publish(info)
        )

    def publish_events(
        self, t: int, *, x: int = 0, count: int = 5, camera: Camera = CAMERA
    ) -> None:
        """Publish `count` events of one column from time t (ns) on, 1 us apart."""
        events = Events(
            np.full(count, x, np.uint16),
            np.zeros(count, np.uint16),
            t + 1000 * np.arange(count, dtype=np.int64),
            np.ones(count, bool),
        )
        self.events.publish(self._encoder.events(t, camera, events))

    def call(self, service_type: Any, name: str, **request: Any) -> Any:
        """Call a service of the node under test.

        A server may answer before it has found the client's reader. Such an answer is lost, so the
        request is sent again. A change of state would fail the second time: the state tells.
        """
        if name not in self._clients:  # to be found by the node takes longer than an answer
            self._clients[name] = self.node.create_client(service_type, name)
        client = self._clients[name]
        self.spin_until(client.service_is_ready, f"service {name}")
        for _ in range(int(WAIT_S / _AGAIN_S)):
            answer = client.call_async(service_type.Request(**request))
            with contextlib.suppress(AssertionError):
                self.spin_until(answer.done, f"answer of {name}", _AGAIN_S)
                return answer.result()
            if service_type is ChangeState:  # the node answers this one after the change
                state = self.call(GetState, name.replace("change_state", "get_state"))
                reached = state.current_state.id == _GOALS.get(request["transition"].id)
                return answer.result() if answer.done() else ChangeState.Response(success=reached)
        raise AssertionError(f"{name}: no answer within {WAIT_S} s")

    def status(self) -> dict[str, str]:
        """Return the latest diagnostics: the numbers, and `message`."""
        if not self.diagnostics:
            return {"message": ""}
        status = self.diagnostics[-1].status[0]
        return {v.key: v.value for v in status.values} | {"message": status.message}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


class Processes:
    """Starts the executables under test in groups of their own, and leaves none behind."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.started: list[subprocess.Popen[bytes]] = []

    def start(self, *command: str) -> subprocess.Popen[bytes]:
        """Start a command; its output goes to a file of its own (see `output`)."""
        log = self._log(len(self.started)).open("wb")
        paths = [str(ROOT), str(ROOT / "test" / "node"), os.environ.get("PYTHONPATH", "")]
        path = os.pathsep.join(p for p in paths if p)
        environment = os.environ | {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}
        with log:
            process = subprocess.Popen(
                command, stdout=log, stderr=log, env=environment, start_new_session=True
            )
        self.started.append(process)
        return process

    def start_node(
        self, factory: str = FACTORY, parameters: Sequence[str] = (), *arguments: str
    ) -> subprocess.Popen[bytes]:
        """Start the node as its console script does; `parameters` as in `name:=value`.

        Unless these say otherwise windows wait, since tests publish faster than a camera, and
        `egomotion/twist` carries one twist per window.
        """
        code = (
            f"import sys; from emoflow_ros.node.executable import main; sys.exit(main('{factory}'))"
        )
        given = [part for parameter in (WAITING, OF_WINDOWS, *parameters)
                 for part in ("-p", parameter)]  # fmt: skip
        return self.start(sys.executable, "-c", code, "--ros-args", *given, *arguments)

    def start_fake(self, estimator: str, *arguments: str) -> subprocess.Popen[bytes]:
        """Start the node with one of the fake estimators, windows of 10 ms."""
        parameters = ("window.duration_ms:=10.0", "output.diagnostics_s:=0.2")
        return self.start_node(f"fake_estimators:{estimator}", parameters, *arguments)

    def output(self, process: subprocess.Popen[bytes]) -> str:
        """Return what the process has written so far."""
        return self._log(self.started.index(process)).read_text()

    def _log(self, index: int) -> Path:
        return self._folder / f"process_{index}.log"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.started:
            for wish, patience_s in (
                (signal.SIGINT, 3.0),
                (signal.SIGTERM, 2.0),
                (signal.SIGKILL, 5.0),
            ):
                if process.poll() is not None:
                    break
                process.send_signal(wish)
                try:
                    process.wait(patience_s)
                except subprocess.TimeoutExpired:
                    continue
            print(f"--- {process.args}\n{self.output(process)}")  # shown if the test fails


def run_windows(peer: Peer, first_ms: int, last_ms: int, x: int = 0) -> None:
    """Publish 5 events every 5 ms: 10 in each window of 10 ms."""
    for t in range(first_ms, last_ms, 5):
        peer.publish_events(t * MS, x=x)
