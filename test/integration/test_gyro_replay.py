"""A replayed bag with a gyro: the node's twists are those of `evaluate`."""

import subprocess
import sys
from itertools import compress
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from harness import Peer, Processes
from shared_node import SharedNode

from emoflow_ros.core.estimate import Status
from emoflow_ros.node.supervisor import FACTORY
from emoflow_ros.offline.estimates import read_estimates
from emoflow_ros.simulation.bags import data_topics, write_bag
from emoflow_ros.simulation.imu import ImuModel, simulate_imu
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import simulate

pytestmark = pytest.mark.dds

START = 1_500_000_000_000_000_000
EVALUATE = "import sys; from emoflow_ros.offline.evaluate import main; sys.exit(main())"
# A window waits 8 ms for the readings at its end, and the IMU is best effort: on a busy machine
# windows go without some readings, and later ones start from a slightly different estimate.
USED = 0.5
TOLERANCE = 5e-3  # rad/s and of a unit vector: a quarter of the gyro's bias
ATTEMPTS = 3


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recording = simulate("calm", duration_s=1.2, seed=5, fps=500, start_ns=START)
    path = tmp_path_factory.mktemp("bag") / "gyro.bag"
    encoder = MessageEncoder(ros1=True)
    imu = simulate_imu(recording.truth, recording.t_start, recording.t_end, ImuModel(), 0)
    write_bag(path, encoder, data_topics(recording, encoder, imu), progress=False)
    return path


def test_node_equals_offline_with_a_gyro(peer: Peer, processes: Processes, bag: Path) -> None:
    out = bag.parent / "offline"
    evaluate = (sys.executable, "-c", EVALUATE, str(bag), "--out", str(out))
    subprocess.run((*evaluate, "--imu", "/davis/left/imu"), check=True)
    columns = read_estimates(out / "estimates.h5").columns
    assert set(columns["status"]) == {Status.OK}

    statuses: list[DiagnosticStatus] = []
    peer.node.create_subscription(DiagnosticStatus, "/egomotion/status", statuses.append, 100)
    node = SharedNode(processes, FACTORY, "input.queue_windows:=50")  # the machine may be busy
    peer.node.destroy_publisher(peer.events)
    node.start(peer, {"imu.use": "auto"})
    peer.hear()
    for _ in range(ATTEMPTS):
        statuses.clear()
        peer.twists.clear()
        replay(bag)
        peer.spin_until(
            lambda: len(statuses) == len(columns["status"]), "the status of every window", 60.0
        )
        said = [{value.key: value.value for value in status.values} for status in statuses]
        used = [values["status"] == "ok" and values["gyro"] == "used" for values in said]
        if np.mean(used) >= USED:
            break
    assert np.mean(used) >= USED
    peer.spin_until(
        lambda: len(peer.twists) == sum(values["status"] == "ok" for values in said), "the twists"
    )
    parts = {round(seconds(t), 3): (t.twist.linear, t.twist.angular) for t in peer.twists}
    mine = [parts[round(float(values["stamp"]), 3)] for values in compress(said, used)]
    found = np.array([[v.x, v.y, v.z, w.x, w.y, w.z] for v, w in mine])
    offline = np.hstack([columns["linear"], columns["angular"]])[used]
    assert np.median(np.abs(found - offline).max(axis=1)) < TOLERANCE


def seconds(twist: TwistStamped) -> float:
    return twist.header.stamp.sec + 1e-9 * twist.header.stamp.nanosec


def replay(bag: Path) -> None:
    command = (sys.executable, "-m", "emoflow_ros.offline.replay", str(bag), "--wait", "60")
    subprocess.run((*command, "--rate", "0.5"), check=True)
