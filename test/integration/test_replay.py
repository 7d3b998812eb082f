"""Replay as a process: what it publishes, and how it refuses."""

import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import TwistStamped
from harness import MS, WAIT_S, Peer, Processes
from repeated import results
from rosbags import rosbag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from shared_node import SharedNode

from emoflow_ros.core.types.events import Events
from emoflow_ros.simulation.messages import MessageEncoder
from emoflow_ros.simulation.recording import SimulatedRecording, simulate
from emoflow_ros.simulation.recording_files import data_topics, write_bag
from emoflow_ros.simulation.simulated_truth import ImuModel, simulate_imu

pytestmark = pytest.mark.dds

START = 1_500_000_000_000_000_000
REPLAY = (sys.executable, "-m", "emoflow_ros.commands.replay")
TOPIC = "/davis/left/events"


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    return simulate("calm", duration_s=0.3, seed=1, fps=200, start_ns=START)


@pytest.fixture(scope="module")
def bags(recording: SimulatedRecording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bags")
    imu = simulate_imu(recording.truth, recording.t_start, recording.t_end, ImuModel(), 0)
    for name, ros1 in (("ros1.bag", True), ("ros2", False)):
        encoder = MessageEncoder(ros1=ros1)
        write_bag(folder / name, encoder, data_topics(recording, encoder, imu), progress=False)
    return folder


def stamp(twist: TwistStamped) -> int:
    return int(twist.header.stamp.sec * 10**9 + twist.header.stamp.nanosec)


def counts_per_window(events: Events, duration: int) -> list[int]:
    """Events in each window of `duration` ns that another event follows."""
    edges = np.arange(events.t[0], events.t[-1] + 1, duration)
    return np.diff(np.searchsorted(events.t, edges)).tolist()


@pytest.fixture
def listener(peer: Peer, recorder: SharedNode) -> SharedNode:
    """The shared node, which finds the event topic of the bag; nobody else publishes any."""
    peer.node.destroy_publisher(peer.events)
    recorder.start(peer, {"input.queue_windows": 50, "input.silence_s": 1.0})
    peer.hear()
    return recorder


@pytest.mark.parametrize(("name", "rate"), [("ros1.bag", "1"), ("ros2", "1"), ("ros1.bag", "5")])
def test_replayed_events_arrive_at_the_estimator_complete(
    peer: Peer,
    processes: Processes,
    listener: SharedNode,
    recording: SimulatedRecording,
    bags: Path,
    name: str,
    rate: str,
) -> None:
    replay = processes.start(*REPLAY, str(bags / name), "--rate", rate, "--wait")
    expected = counts_per_window(recording.events, 10 * MS)
    peer.spin_until(lambda: len(peer.twists) == len(expected), "a twist for every window")
    assert [int(t.twist.angular.x) for t in peer.twists] == expected
    assert {t.twist.angular.z for t in peer.twists} == {346.0}  # the bag's camera_info
    assert replay.wait(WAIT_S) == 0
    assert f"listening to {TOPIC} (dvs_msgs/msg/EventArray)" in listener.output


def test_every_round_of_a_looped_bag_is_an_epoch(
    peer: Peer,
    processes: Processes,
    listener: SharedNode,
    recording: SimulatedRecording,
    bags: Path,
) -> None:
    processes.start(*REPLAY, str(bags / "ros2"), "--loop", "--wait")
    peer.spin_until(lambda: int(peer.status().get("time_jumps", "0")) >= 2, "three rounds")

    def rounds_seen() -> list[np.ndarray]:
        stamps = np.array([stamp(twist) for twist in peer.twists])
        return np.split(stamps, np.flatnonzero(np.diff(stamps) < 0) + 1)

    peer.spin_until(lambda: len(rounds_seen()) >= 2, "twists of two rounds")
    rounds = rounds_seen()
    starts = recording.events.t[0] + 5 * MS
    assert {int(r[0]) for r in rounds} == {int(starts)}  # cut alike, from the first event on
    assert all((np.diff(r) == 10 * MS).all() for r in rounds)
    assert "event time went back by 0." in listener.output


def test_paused_replay_warns_and_goes_on_without_a_jump(
    peer: Peer,
    processes: Processes,
    listener: SharedNode,
    recording: SimulatedRecording,
    bags: Path,
) -> None:
    replay = processes.start(*REPLAY, str(bags / "ros2"), "--rate", "0.1", "--wait")
    peer.spin_until(lambda: len(peer.twists) >= 3, "some twists")
    replay.send_signal(signal.SIGSTOP)
    peer.spin_until(lambda: "no events for" in peer.status()["message"], "the warning")
    replay.send_signal(signal.SIGCONT)
    expected = counts_per_window(recording.events, 10 * MS)
    peer.spin_until(lambda: len(peer.twists) == len(expected), "a twist for every window")
    assert [int(t.twist.angular.x) for t in peer.twists] == expected
    assert {t.twist.angular.z for t in peer.twists} == {346.0}
    assert peer.status()["time_jumps"] == "0"
    assert replay.wait(WAIT_S) == 0
    assert f"listening to {TOPIC} (dvs_msgs/msg/EventArray)" in listener.output


def test_clock_and_rate(peer: Peer, processes: Processes, bags: Path) -> None:
    ticks: list[tuple[float, int]] = []

    def take(message: Clock) -> None:
        ticks.append((time.monotonic(), message.clock.sec * 10**9 + message.clock.nanosec))

    peer.node.create_subscription(Clock, "/clock", take, 100)
    peer.node.create_subscription(Imu, "/davis/left/imu", lambda _: None, 10)
    topics = ("--topics", "/davis/left/imu")
    replay = processes.start(
        *REPLAY, str(bags / "ros1.bag"), "--clock", "--rate", "0.25", "--wait", *topics
    )
    peer.spin_until(lambda: ticks and ticks[-1][1] >= START + 280 * MS, "the clock")
    stamps = [stamp for _, stamp in ticks]
    assert stamps[0] == START
    assert set(np.diff(stamps)) == {10 * MS}
    elapsed = ticks[-1][0] - ticks[0][0]
    # A busy machine only makes it slower.
    assert elapsed > (stamps[-1] - stamps[0]) / 1e9 / 0.25 - 0.15
    assert peer.events.get_subscription_count() == 0
    assert replay.wait(WAIT_S) == 0


def test_interrupt_ends_the_loop(peer: Peer, processes: Processes, bags: Path) -> None:
    stamps: list[tuple[int, int]] = []

    def take(message: Imu) -> None:
        stamps.append((message.header.stamp.sec, message.header.stamp.nanosec))

    peer.node.create_subscription(Imu, "/davis/left/imu", take, 10)
    topics = ("--topics", "/davis/left/imu")
    replay = processes.start(*REPLAY, str(bags / "ros2"), "--loop", "--wait", *topics)
    peer.spin_until(lambda: stamps != sorted(stamps), "the second round")
    replay.send_signal(signal.SIGINT)
    assert replay.wait(WAIT_S) == 130  # it would go on for ever
    output = processes.output(replay)
    assert "Traceback" not in output
    assert "%|" not in output  # a progress bar is for terminals


def missing(folder: Path, good: Path) -> Path:
    return folder / "no.bag"


def empty(folder: Path, good: Path) -> Path:
    (folder / "empty.bag").touch()
    return folder / "empty.bag"


def truncated(folder: Path, good: Path) -> Path:
    data = good.read_bytes()
    (folder / "cut.bag").write_bytes(data[:4000])  # within its header: nothing is whole
    return folder / "cut.bag"


def no_bag(folder: Path, good: Path) -> Path:
    (folder / "text.bag").write_text("events, but not in a bag\n")
    return folder / "text.bag"


def refusals(*arguments: Sequence[str]) -> list[str]:
    """The single line that `replay` says to each of these arguments."""
    found = results("emoflow_ros.commands.replay:main", arguments)
    assert [code for code, _ in found] == [2] * len(arguments), found
    return [said for _, [said] in found]


def test_bad_bag_is_one_line(bags: Path, tmp_path: Path) -> None:
    paths = [make(tmp_path, bags / "ros1.bag") for make in (missing, empty, truncated, no_bag)]
    for path, said in zip(paths, refusals(*([str(path)] for path in paths)), strict=True):
        assert said.startswith(f"error: {path}: ")


BAD_ARGUMENTS = [
    (("--topics", "/odd"), "no topic /odd; the bag holds /davis/left/camera_info, "),
    (("--rate", "0"), "error: --rate: 0; give a rate in [0.001, 1000]"),
    (("--ros-args", "-r", "bad"), "error: -r bad: not of the form FROM:=TO with two ROS names"),
    (
        ("--ros-args", "-p", "use_sim_time:=foo"),
        "error: use_sim_time: 'foo' is not of type bool",
    ),
]


def test_bad_argument_is_one_line(bags: Path) -> None:
    said = refusals(*((str(bags / "ros1.bag"), *arguments) for arguments, _ in BAD_ARGUMENTS))
    for found, (_, line) in zip(said, BAD_ARGUMENTS, strict=True):
        assert line in found


def test_types_that_are_not_installed_are_left_out(processes: Processes, tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("uint32 value", "odd_msgs/msg/Odd"))
    with rosbag1.Writer(tmp_path / "odd.bag") as writer:
        for topic, kind in (("/odd", "odd_msgs/msg/Odd"), ("/text", "std_msgs/msg/String")):
            connection = writer.add_connection(topic, kind, typestore=store)
            writer.write(connection, START, bytes(4))
    replay = processes.start(*REPLAY, str(tmp_path / "odd.bag"))
    assert replay.wait(WAIT_S) == 0
    output = processes.output(replay)
    assert (
        "left out: /odd: odd_msgs/msg/Odd: the message package odd_msgs is not installed" in output
    )
    assert "1 messages published" in output
