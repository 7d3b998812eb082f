"""What `make demo` shows: a simulated bag through the running node, against the truth.

Every command runs as `ros2 run` starts it, in a process of its own, and this process is the
subscriber.
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import rclpy
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from emoflow_ros.cli import run
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.estimates_file import Estimates, read_estimates
from emoflow_ros.evaluation.metrics import angle_deg
from emoflow_ros.node.topic_search import import_message_type
from emoflow_ros.node.twist_output import to_ns
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import Truth, load_truth
from msg_adapters import make_decoder

_SCENE = "calm"
_DURATION_S = 2.5
_EVENTS = "/davis/left/events"
_EVENTS_TYPE = "sensor_msgs/msg/PointCloud2"  # every ROS has it, so that nothing need be built
_DOMAIN = "86"
_WAIT_S = 120.0
_QUIET_S = 3.0
# Every window is compared: on a slow or busy machine twists come late, and none is left out.
_ALL_WINDOWS = ("-p", "input.queue_windows:=100")
_STOP_S = 5.0
_EXIT_INCOMPLETE = 1
type Vector = NDArray[np.float64]


@dataclass
class Collected:
    """What came over DDS.

    Attributes:
        twists: those of windows, (linear, angular) by stamp in ns.
        twist_arrivals: monotonic time in s by stamp, of the same.
        present_arrivals: the same of the latest twists.
        event_arrivals: (time of the message's last event in ns, monotonic time in s).
        least_share: of their events that the node estimated windows with.
    """

    twists: dict[int, tuple[Vector, Vector]] = field(default_factory=dict)
    twist_arrivals: dict[int, float] = field(default_factory=dict)
    present_arrivals: dict[int, float] = field(default_factory=dict)
    event_arrivals: list[tuple[int, float]] = field(default_factory=list)
    least_share: float = 1.0

    def note_share(self, message: DiagnosticArray) -> None:
        """Note the share of the events that the node's diagnostics tell."""
        told = (value for status in message.status for value in status.values)
        shares = [float(value.value) for value in told if value.key == "events_share"]
        self.least_share = min([self.least_share, *shares])

    @property
    def remark(self) -> str:
        """Why twists may differ from evaluate's: the node was late; else empty."""
        if self.least_share == 1.0:
            return ""
        share = f"{100 * self.least_share:.0f} %"
        return f"the node was late: some windows had {share} of their events, unlike evaluate's"

    def latency_ms(self, stamp: int, t_end: int) -> float:
        """Time from the event that completed the window to the twist; NaN if one is missing."""
        return self._since(t_end, self.twist_arrivals.get(stamp))

    def present_ages_ms(self) -> list[float]:
        """Time from the event at each stamp to the latest twist with that stamp."""
        return [self._since(stamp, arrival) for stamp, arrival in self.present_arrivals.items()]

    def _since(self, t: int, arrival: float | None) -> float:
        event = next((arrived for last, arrived in self.event_arrivals if last >= t), None)
        return float("nan") if event is None or arrival is None else (arrival - event) * 1e3


def main() -> int:
    """Run the demonstration."""
    return run(_main)


def _main() -> int:
    parser = argparse.ArgumentParser(
        prog="demo",
        description="Simulate a short sequence, replay it through the running node and compare "
        "what the node publishes with the truth.",
    )
    parser.add_argument("--out", type=Path, default=Path("out/demo"), metavar="DIR")
    folder: Path = parser.parse_args().out
    os.environ["ROS_DOMAIN_ID"] = os.environ.get("ROS_DOMAIN_ID", _DOMAIN)

    _announce(f"simulating {_DURATION_S:g} s of the scene '{_SCENE}'")
    duration = ("--duration", str(_DURATION_S))
    events = ("--events", _EVENTS_TYPE.rpartition("/")[2])
    _execute("simulate", _SCENE, "--out", str(folder), *duration, *events, "--force")
    bag = folder / f"{_SCENE}_data.bag"
    truth_files = [folder / f"{_SCENE}_gt.bag", folder / f"{_SCENE}_gt_flow_dist.npz"]
    _announce("replaying it through the node")
    collected = _replay_through_node(bag)
    _announce("evaluating the same bag without ROS, for the report")
    _execute("evaluate", str(bag), "--gt", *map(str, truth_files), "--out", str(folder))
    estimates = read_estimates(folder / "estimates.h5")
    with open_recording(bag) as recording:
        truth = load_truth(recording, truth_files)
        return _show(collected, estimates, truth, folder)


class _Subscriber(Node):
    """Collects twists, and when the events arrived that they are made of."""

    def __init__(self) -> None:
        super().__init__("demo")
        self.collected = Collected()
        self._decoder = make_decoder(_EVENTS_TYPE, "cdr")
        self.twists = self.create_subscription(
            TwistWithCovarianceStamped, "/egomotion/twist_with_covariance", self._take_twist, 100
        )
        self.create_subscription(TwistStamped, "/egomotion/twist", self._take_present, 1000)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.collected.note_share, 100)
        # Replay starts with the first subscriber, and that shall be the node.
        self._wait = self.create_timer(0.02, self._follow_the_node)

    def _follow_the_node(self) -> None:
        if self.count_subscribers(_EVENTS):
            self.destroy_timer(self._wait)
            self.create_subscription(
                import_message_type(_EVENTS_TYPE), _EVENTS, self._take_events, 1000, raw=True
            )

    def _take_present(self, message: TwistStamped) -> None:
        self.collected.present_arrivals[to_ns(message.header.stamp)] = time.monotonic()

    def _take_twist(self, message: TwistWithCovarianceStamped) -> None:
        stamp = to_ns(message.header.stamp)
        v, w = message.twist.twist.linear, message.twist.twist.angular
        self.collected.twists[stamp] = (np.array([v.x, v.y, v.z]), np.array([w.x, w.y, w.z]))
        self.collected.twist_arrivals[stamp] = time.monotonic()

    def _take_events(self, data: bytes) -> None:
        events = self._decoder.decode(data).events
        if len(events):
            self.collected.event_arrivals.append((int(events.t[-1]), time.monotonic()))


def _replay_through_node(bag: Path) -> Collected:
    """Run node, replay and subscriber until all twists have come."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        subscriber = _Subscriber()
        arguments = ("--ros-args", "-r", f"events:={_EVENTS}", *_ALL_WINDOWS)
        with _running("estimator", *arguments) as estimator:
            while not subscriber.twists.get_publisher_count():
                _spin_with(subscriber, estimator)
            with _running("replay", str(bag), "--wait", str(_WAIT_S)) as replay:
                while replay.poll() is None:
                    _spin_with(subscriber, estimator)
            quiet_since = time.monotonic()
            while time.monotonic() - quiet_since < _QUIET_S:
                before = len(subscriber.collected.twists)
                _spin_with(subscriber, estimator)
                if len(subscriber.collected.twists) > before:
                    quiet_since = time.monotonic()
        return subscriber.collected
    finally:
        try_shutdown()


@contextmanager
def _running(name: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([_executable(name), *arguments], start_new_session=True)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)  # nothing happens if it has ended
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()


def _spin_with(subscriber: _Subscriber, estimator: subprocess.Popen[bytes]) -> None:
    if estimator.poll() is not None:
        raise InputError("estimator", "the node ended", "see its message above")
    rclpy.spin_once(subscriber, timeout_sec=0.1)


def _show(collected: Collected, estimates: Estimates, truth: Truth, folder: Path) -> int:
    """Print a row per window; 0 if a twist came for each that could be estimated."""
    columns = estimates.columns
    print(f"\n{'':6}  {'angular velocity, deg/s (x, y, z)':^42}  {'error':>6}  {'direction':>9}")
    print(f"window  {'node':^20}  {'truth':^20}  {'deg/s':>6}  error/deg  {'ms':>5}")
    expected = arrived = 0
    differences = [0.0]
    for i in range(len(estimates)):
        t_start, t_end = int(columns["t_start_ns"][i]), int(columns["t_end_ns"][i])
        stamp = (t_start + t_end) // 2
        expected += columns["status"][i] == "ok"
        if stamp not in collected.twists:
            known = columns["status"][i]
            print(f"{i:6}  no twist: {'dropped by the node, or late' if known == 'ok' else known}")
            continue
        arrived += 1
        linear, angular = collected.twists[stamp]
        differences.append(float(np.abs(angular - columns["angular"][i]).max()))
        true = truth.twists.twist(stamp) if truth.twists else None
        true_angular = true.angular if true else np.full(3, np.nan)
        true_linear = true.linear if true and true.linear is not None else np.full(3, np.nan)
        error = np.degrees(np.linalg.norm(angular - true_angular))
        direction = angle_deg(linear, true_linear) if linear.any() else np.nan
        print(
            f"{i:6}  {_degrees(angular)}  {_degrees(true_angular)}  {error:6.2f}  "
            f"{direction:9.1f}  {collected.latency_ms(stamp, t_end):5.0f}"
        )
    print(
        f"\n{arrived} of {expected} twists came over DDS; largest difference from evaluate: "
        f"{np.degrees(max(differences)):.4f} deg/s"
    )
    if collected.remark:
        print(collected.remark)
    print("ms: from the event that completes a window to the arrival of its twist")
    if ages := collected.present_ages_ms():  # none where windows wait so long as to be of the past
        print(
            f"{len(ages)} latest twists came on /egomotion/twist; from the event at their stamp "
            f"they took {np.nanmedian(ages):.0f} ms (median)"
        )
    for name in ("report.html", "report.json", "estimates.h5"):
        print(folder / name)
    return 0 if 0 < arrived == expected else _EXIT_INCOMPLETE


def _degrees(angular: Vector) -> str:
    return " ".join(f"{value:6.2f}" for value in np.degrees(angular))


def _execute(name: str, *arguments: str) -> None:
    finished = subprocess.run([_executable(name), *arguments], check=False)
    if finished.returncode:
        raise InputError(name, f"exit code {finished.returncode}", "see its message above")


def _executable(name: str) -> str:
    try:
        return f"{get_package_prefix('emoflow_ros')}/lib/emoflow_ros/{name}"
    except (PackageNotFoundError, OSError):
        raise InputError("emoflow_ros", "not installed", "source install/setup.bash") from None


def _announce(step: str) -> None:
    print(f"== {step}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
