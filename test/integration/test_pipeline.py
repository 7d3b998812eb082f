"""Three real processes: replay, estimator and a subscriber, with values held against the truth."""

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistWithCovarianceStamped
from harness import Peer, Processes, children
from shared_node import SharedNode, Values

from emoflow_ros.core.types.estimate import Status
from emoflow_ros.evaluation.estimates_file import read_estimates
from emoflow_ros.node.twist_output import to_ns
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.simulation.recording_files import data_topics, write_bag
from emoflow_ros.simulation.simulated_truth import ImuModel, simulate_imu

pytestmark = pytest.mark.dds

REPLAY = (sys.executable, "-m", "emoflow_ros.commands.replay")
EVALUATE = "import sys; from emoflow_ros.commands.evaluate import main; sys.exit(main())"
RATE = "0.1"  # so slow that no window waits, and is thinned, also on a busy machine
TOLERANCE = 1e-6  # rad/s and of a unit vector: the node's twists are the offline ones
# A window waits 8 ms for the readings at its end, and the IMU is best effort: on a busy machine
# windows go without some readings, and later ones start from a slightly different estimate. The
# slower the replay, the less of the recording such a pause covers.
USED = 0.5
GYRO_TOLERANCE = 5e-3  # rad/s and of a unit vector: a quarter of the gyro's bias
RATES = (RATE, "0.04", "0.02")
START = 1_500_000_000_000_000_000


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    return simulate("calm", duration_s=1.2, seed=5, fps=500, start_ns=START)


@pytest.fixture(scope="module")
def bag(recording: SimulatedRecording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "calm.bag"
    encoder = MessageEncoder(ros1=True)
    imu = simulate_imu(recording.truth, recording.t_start, recording.t_end, ImuModel(), 0)
    write_bag(path, encoder, data_topics(recording, encoder, imu), progress=False)
    return path


@dataclass(frozen=True)
class Window:
    """What `evaluate` says about a window, which starts and ends at `t` -+ half its length."""

    t: int
    status: str
    events: int
    angular: np.ndarray
    linear: np.ndarray


@pytest.fixture(scope="module")
def expected(bag: Path) -> list[Window]:
    return evaluate(bag)


def evaluate(bag: Path, *options: str) -> list[Window]:
    """Send the bag through the executable `evaluate`."""
    out = bag.parent / "-".join(["offline", *(o.strip("-/").replace("/", "-") for o in options)])
    command = (sys.executable, "-c", EVALUATE, str(bag), "--out", str(out), *options)
    subprocess.run(command, check=True)
    columns = read_estimates(out / "estimates.h5").columns
    middles = (columns["t_start_ns"] + columns["t_end_ns"]) // 2
    names = ("status", "events", "angular", "linear")
    rows = zip(middles.tolist(), *(columns[name] for name in names), strict=True)
    return [Window(*row) for row in rows]


def stamps(peer: Peer) -> list[int]:
    return [t.header.stamp.sec * 10**9 + t.header.stamp.nanosec for t in peer.twists]


def start(
    peer: Peer,
    node: SharedNode,
    processes: Processes,
    bag: Path,
    values: Values | None = None,
) -> None:
    peer.node.destroy_publisher(peer.events)
    node.start(peer, values)
    peer.hear()
    processes.start(*REPLAY, str(bag), "--wait", "600", "--rate", RATE)


def test_twists_of_now_come_beside_those_of_windows(
    peer: Peer,
    node: SharedNode,
    processes: Processes,
    recording: SimulatedRecording,
    bag: Path,
    expected: list[Window],
) -> None:
    now: list[TwistWithCovarianceStamped] = []
    ahead: list[int] = []

    def take(message: TwistWithCovarianceStamped) -> None:
        now.append(message)
        if peer.covariances:
            ahead.append(to_ns(message.header.stamp) - to_ns(peer.covariances[-1].header.stamp))

    topic = "/egomotion/twist_now"
    peer.node.create_subscription(TwistWithCovarianceStamped, topic, take, 100)
    start(peer, node, processes, bag, {"output.twist_rate": 50.0})
    peer.spin_until(
        lambda: peer.covariances and to_ns(peer.covariances[-1].header.stamp) == expected[-1].t,
        "the last window",
    )
    # Slices do not change the windows.
    for message, window in zip(peer.covariances, expected, strict=True):
        w = message.twist.twist.angular
        np.testing.assert_allclose([w.x, w.y, w.z], window.angular, atol=TOLERANCE)
    # A twist goes out on two topics, one after the other.
    peer.spin_until(lambda: len(stamps(peer)) == len(now), "the same twists on both")
    times = np.array([to_ns(message.header.stamp) for message in now])
    assert stamps(peer) == times.tolist()
    assert len(times) >= 10
    assert (np.diff(times) > 0).all() and not (np.diff(times) % 20_000_000).any()
    # A window's own twist is of its middle.
    assert np.median(ahead) > 67_500_000
    found = [m.twist.twist.angular for m in now]
    errors = [
        np.degrees(np.linalg.norm([w.x, w.y, w.z] - recording.truth.twist(t)[1]))
        for w, t in zip(found, times.tolist(), strict=True)
    ]
    assert np.median(errors) < 5.0


def test_node_publishes_what_the_estimator_finds_and_that_is_true(
    peer: Peer,
    node: SharedNode,
    processes: Processes,
    recording: SimulatedRecording,
    bag: Path,
    expected: list[Window],
) -> None:
    assert len(expected) >= 12
    assert all(e.status == Status.OK for e in expected)
    peer.subscribe_flow()
    statuses: list[DiagnosticStatus] = []
    peer.node.create_subscription(DiagnosticStatus, "/egomotion/status", statuses.append, 100)
    start(peer, node, processes, bag)
    peer.spin_until(lambda: len(peer.twists) == len(expected), "the last twist")
    # Where time is short a picture is left out, perhaps the last one, but no window.
    peer.spin_until(
        lambda: peer.images and peer.status().get("windows_ok") == str(len(expected)),
        "a picture and the count of all windows",
    )
    assert peer.status()["windows_dropped"] == "0"

    # Nothing is missing, and it is what `evaluate` makes of the same windows.
    assert stamps(peer) == [e.t for e in expected]
    peer.spin_until(lambda: len(statuses) == len(expected), "the status of the last window")
    said = [{v.key: v.value for v in status.values} for status in statuses]
    assert [int(values["events"]) for values in said] == [e.events for e in expected]
    angular = np.array([list(_xyz(t.twist.angular)) for t in peer.twists])
    linear = np.array([list(_xyz(t.twist.linear)) for t in peer.twists])
    np.testing.assert_allclose(angular, [e.angular for e in expected], rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(linear, [e.linear for e in expected], rtol=0, atol=TOLERANCE)

    # And that is the camera's motion.
    true = [recording.truth.twist(t) for t in stamps(peer)]
    true_linear, true_angular = (np.array(part) for part in zip(*true, strict=True))
    error = np.degrees(np.linalg.norm(angular - true_angular, axis=1))
    assert np.median(error) < 6.0
    direction = true_linear / np.linalg.norm(true_linear, axis=1, keepdims=True)
    off = np.degrees(np.arccos(np.clip((linear * direction).sum(axis=1), -1, 1)))
    assert np.median(off) < 25.0

    # So is the flow: px/s at the same time, u right and v down.
    last = peer.images[-1]
    flow = np.frombuffer(last.data, "<f4").reshape(last.height, last.width, 2)
    assert to_ns(last.header.stamp) in stamps(peer)
    true_flow = recording.truth.flow(to_ns(last.header.stamp))
    valid = np.isfinite(flow).all(axis=2) & np.isfinite(true_flow).all(axis=2)
    assert valid.mean() > 0.5
    wrong = np.linalg.norm(flow - true_flow, axis=2)[valid].mean()
    assert wrong < 0.35 * np.linalg.norm(true_flow, axis=2)[valid].mean()


def test_killed_worker_costs_one_window_of_a_running_replay(
    peer: Peer, node: SharedNode, processes: Processes, bag: Path, expected: list[Window]
) -> None:
    start(peer, node, processes, bag)
    peer.spin_until(lambda: len(peer.twists) >= 4, "some twists")
    os.kill(_worker(node), signal.SIGKILL)
    peer.spin_until(lambda: stamps(peer)[-1] == expected[-1].t, "the last twist")
    # The one that it was working on is lost, if there was one.
    assert len(expected) - 1 <= len(peer.twists) <= len(expected)
    peer.spin_until(lambda: peer.status().get("worker_restarts") == "1", "the count")
    assert peer.status()["windows_dropped"] == "0"


def test_node_equals_offline_with_a_gyro(peer: Peer, node: SharedNode, bag: Path) -> None:
    expected = evaluate(bag, "--imu", "/davis/left/imu")
    assert {e.status for e in expected} == {Status.OK}
    statuses: list[DiagnosticStatus] = []
    peer.node.create_subscription(DiagnosticStatus, "/egomotion/status", statuses.append, 100)
    peer.node.destroy_publisher(peer.events)
    node.start(peer, {"imu.use": "auto"})
    peer.hear()
    used, off = [False], np.inf
    for rate in RATES:
        statuses.clear()
        peer.twists.clear()
        subprocess.run((*REPLAY, str(bag), "--wait", "600", "--rate", rate), check=True)
        if not peer.spin_while_alive(lambda: len(statuses) == len(expected), beats=100):
            continue  # messages are lost
        said = [{value.key: value.value for value in status.values} for status in statuses]
        used = [values["status"] == "ok" and values["gyro"] == "used" for values in said]
        with_twist = [values["status"] == "ok" for values in said]
        count = sum(with_twist)
        peer.spin_until(lambda count=count: len(peer.twists) == count, "the twists")
        mine = compress(peer.twists, compress(used, with_twist))
        found = [[*_xyz(t.twist.linear), *_xyz(t.twist.angular)] for t in mine]
        offline = [[*e.linear, *e.angular] for e in compress(expected, used)]
        off = np.median(np.abs(np.subtract(found, offline)).max(axis=1)) if found else np.inf
        if np.mean(used) >= USED and off < GYRO_TOLERANCE:
            break
    assert np.mean(used) >= USED
    assert off < GYRO_TOLERANCE


def _worker(node: SharedNode) -> int:
    """Return the process id of the worker: the node's only grandchild."""
    [worker] = [grandchild for child in children(node.pid) for grandchild in children(child)]
    return worker


def _xyz(vector: object) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z  # type: ignore[attr-defined]
