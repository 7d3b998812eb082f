"""The node's further topics over DDS: the status of every window, pictures, sampled twists."""

import importlib.util
import re
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped
from harness import CAMERA, MS, WAIT_S, Peer, Processes, run_windows
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Image
from shared_node import SharedNode
from visualization_msgs.msg import Marker

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import flow_to_rgb

pytestmark = pytest.mark.dds


def listen(peer: Peer, message_type: Any, topic: str) -> list[Any]:
    """Subscribe, and return the list that the messages come into."""
    messages: list[Any] = []
    peer.node.create_subscription(message_type, topic, messages.append, 100)
    return messages


def wait_for_topic(peer: Peer, topic: str) -> None:
    peer.spin_until(lambda: peer.node.count_publishers(topic), f"{topic} is there")


def stamp(message: Any) -> int:
    """Stamp of a message, ns."""
    time = message.header.stamp
    return int(time.sec * 1_000_000_000 + time.nanosec)


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {v.key: v.value for v in status.values}


type Start = Callable[..., SharedNode]


@pytest.fixture
def start(peer: Peer, recorder: SharedNode) -> Start:
    def make(**values: str | float) -> SharedNode:
        """Start the shared node; `output__tracks` is the parameter `output.tracks`."""
        recorder.start(peer, {name.replace("__", "."): value for name, value in values.items()})
        peer.connect()
        peer.publish_camera()
        return recorder

    return make


def test_killed_worker_costs_one_window_and_one_line(peer: Peer, processes: Processes) -> None:
    statuses: list[DiagnosticStatus] = listen(peer, DiagnosticStatus, "/egomotion/status")
    node = processes.start_fake("Dying")
    peer.connect()
    peer.publish_camera()
    wait_for_topic(peer, "/egomotion/status")
    run_windows(peer, 1000, 1020)
    run_windows(peer, 1020, 1030, x=7)  # the third window kills the worker
    run_windows(peer, 1030, 1061)
    peer.spin_until(lambda: len(statuses) == 6 and len(peer.twists) == 5, "all windows but one")
    assert [stamp(t) // MS for t in peer.twists] == [1005, 1015, 1035, 1045, 1055]
    assert [s.level for s in statuses] == [b"\x00", b"\x00", b"\x02", *[b"\x00"] * 3]
    assert [values(s)["stamp"] for s in statuses] == [f"1.0{k}5000000" for k in range(6)]
    assert statuses[0].name == "/estimator: window"
    assert values(statuses[0])["model"] == "full"
    assert values(statuses[0])["stop_reason"] == "converged"
    assert float(values(statuses[0])["lag_ms"]) > 0
    assert "the worker died (signal 9)" in statuses[2].message
    assert values(statuses[2])["events"] == "10"
    lines = [line for line in processes.output(node).splitlines() if "ERROR" in line]
    assert len(lines) == 1
    assert "the worker died (signal 9); it is started again" in lines[0]
    peer.spin_until(lambda: peer.status().get("worker_restarts") == "1", "the count")


def test_overload_drops_the_oldest_windows_and_recovers(peer: Peer, processes: Processes) -> None:
    statuses: list[DiagnosticStatus] = listen(peer, DiagnosticStatus, "/egomotion/status")
    node = processes.start_fake("Slow", "-p", "input.queue_windows:=10")
    peer.connect()
    peer.publish_camera()
    wait_for_topic(peer, "/egomotion/status")
    for t in range(1000, 1401, 5):  # 40 windows of 10 ms at their rate, five times too fast
        peer.publish_events(t * MS)
        peer.spin_for(0.005)
    peer.spin_until(lambda: len(statuses) == 40, "a status for each of 40 windows")
    kinds = [values(s)["status"] for s in statuses]
    assert set(kinds) == {"ok", "dropped"}
    assert len({values(s)["stamp"] for s in statuses}) == 40
    received = kinds.count("ok")
    peer.spin_until(lambda: len(peer.twists) == received, "a twist for each estimate")
    assert stamp(peer.twists[-1]) == 1395 * MS  # the newest window
    assert 3 <= received < 40
    peer.spin_until(lambda: peer.status().get("windows_ok") == str(received), "the count")
    assert int(peer.status()["windows_dropped"]) == 40 - received
    # The fake estimator sleeps, as one does that gets nothing of the processor.
    said = "".join(s.message for d in peer.diagnostics for s in d.status)
    assert " windows dropped: other processes leave the estimation 0% of a core; end them" in said
    for t in (1405, 1410):  # one window, in time
        peer.publish_events(t * MS)
    peer.spin_until(lambda: stamp(peer.twists[-1]) == 1405 * MS, "the window after the overload")
    assert int(peer.status()["windows_dropped"]) == 40 - received
    assert node.poll() is None


def test_pictures_are_drawn_for_their_subscribers(peer: Peer, start: Start) -> None:
    colors: list[Image] = listen(peer, Image, "/flow/color")
    sharpened: list[Image] = listen(peer, Image, "/flow/iwe")
    start(output__flow_color_max=4.0, camera__frame_id="my_frame")
    wait_for_topic(peer, "/flow/iwe")
    clock = iter(range(1000, 10_000, 5))

    def publish_until_both() -> bool:
        peer.publish_events(next(clock) * MS, x=9)
        return bool(colors and sharpened)

    peer.spin_until(publish_until_both, "both pictures")
    color, iwe = colors[0], sharpened[0]
    assert (color.encoding, color.width, color.height, color.step) == ("rgb8", 64, 48, 192)
    assert (iwe.encoding, iwe.width, iwe.height, iwe.step) == ("mono8", 64, 48, 64)
    assert color.header.frame_id == iwe.header.frame_id == "my_frame"
    rgb = np.frombuffer(color.data, np.uint8).reshape(48, 64, 3)
    assert (rgb[:, 0] == 0).all()  # no flow
    flow = np.tile(np.float32([1, -2]), (48, 63, 1))
    np.testing.assert_array_equal(rgb[:, 1:], flow_to_rgb(flow, 4.0))
    grey = np.frombuffer(iwe.data, np.uint8).reshape(48, 64)
    assert grey[0, 9] == 255
    assert np.count_nonzero(grey) == 1


def test_tracks_are_drawn_for_their_subscriber(peer: Peer, start: Start) -> None:
    markers: list[Marker] = listen(peer, Marker, "/flow/tracks")
    start(output__tracks=12, camera__frame_id="my_frame")
    clock = iter(range(1000, 10_000_000, 5))

    def pair() -> tuple[Marker, Marker] | None:
        """Tracks that begin, and those of the next window: a busy node leaves some out."""
        for first, second in pairwise(markers):
            begin = len(first.points) == 2 * 12 * 2 and first.colors[0].a == 0
            if begin and stamp(second) - stamp(first) == 10 * MS:
                return first, second
        return None

    def publish_until_two() -> bool:
        peer.publish_events(next(clock) * MS, x=9)
        return pair() is not None

    peer.spin_until(publish_until_two, "tracks of two windows")
    found = pair()
    assert found is not None
    first, second = found
    assert first.header.frame_id == "my_frame"
    assert first.type == Marker.LINE_LIST
    points = np.array([[p.x, p.y, p.z] for p in first.points]).reshape(2, 12, 2, 3)
    # The first pixel is (7.5, 7.5); (1, -2) px/s for half of 10 ms.
    np.testing.assert_allclose(points[0, 0, 0], [(7.5 - 32) / 50, (7.5 - 24) / 50, 1], rtol=1e-6)
    moved = np.tile(np.array([1, -2, 0]) * 0.005 / 50, (2, 12, 1))
    np.testing.assert_allclose(points[:, :, 1] - points[:, :, 0], moved, atol=1e-7)
    assert [c.a for c in first.colors[:2]] == [0.0, 0.5]
    # Three points began anew, the others go on.
    assert len(second.points) == 2 * (9 * 2 + 12 * 2)


def test_twist_in_a_target_frame(peer: Peer, start: Start) -> None:
    """The optical frame in a body with x forward, y left and z up."""
    start(
        output__target_frame="base",
        output__target_source="parameter",
        output__target_roll=-np.pi / 2,
        output__target_yaw=-np.pi / 2,
    )
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: peer.twists and peer.covariances, "a window")
    assert peer.twists[0].header.frame_id == peer.covariances[0].header.frame_id == "base"
    linear = peer.twists[0].twist.linear
    np.testing.assert_allclose([linear.x, linear.y, linear.z], [0.8, 0.0, -0.6], atol=1e-12)
    angular = peer.covariances[0].twist.twist.angular  # (10, 1, 64) in the optical frame
    np.testing.assert_allclose([angular.x, angular.y, angular.z], [64, -10, -1], atol=1e-12)


@pytest.mark.skipif(importlib.util.find_spec("tf2_ros") is not None, reason="tf2_ros is there")
def test_tf_that_is_not_installed_is_refused_in_one_line(processes: Processes) -> None:
    node = processes.start_fake("Recorder", "-p", "output.target_frame:=base")
    assert node.wait(WAIT_S) == 2
    [line] = re.findall(r"^error: .*", processes.output(node), re.MULTILINE)
    assert line.startswith("error: output.target_source: tf needs the package tf2_ros")


def test_speed_from_odometry_until_it_is_too_old(peer: Peer, start: Start) -> None:
    statuses: list[DiagnosticStatus] = listen(peer, DiagnosticStatus, "/egomotion/status")
    publisher = peer.node.create_publisher(Odometry, "/odom", 10)
    start(scale__source="topic", scale__max_age_s=10.0)
    peer.spin_until(publisher.get_subscription_count, "the node listens to the odometry")
    odometry = Odometry()
    odometry.header.stamp.sec = 1
    odometry.twist.twist.linear.x, odometry.twist.twist.linear.y = 3.0, -4.0
    publisher.publish(odometry)
    clock = iter(range(1000, 9000, 5))

    def publish_until_scaled() -> bool:
        peer.publish_events(next(clock) * MS)
        return bool(statuses) and values(statuses[-1])["scale"] == "topic"

    peer.spin_until(publish_until_scaled, "a window with a scale")
    assert statuses[-1].message == "ok, wide: start"
    last = values(statuses[-1])["stamp"]

    def same_window() -> list[TwistStamped]:
        return [t for t in peer.twists if f"{stamp(t) / 1e9:.9f}" == last]

    peer.spin_until(same_window, "its twist")
    linear = same_window()[0].twist.linear
    np.testing.assert_allclose([linear.x, linear.y, linear.z], [0.0, 3.0, 4.0])
    run_windows(peer, 20_000, 20_011)
    late = "20.005000000"
    peer.spin_until(lambda: values(statuses[-1])["stamp"] == late, "a window 19 s later")
    assert statuses[-1].level == b"\x01"
    assert statuses[-1].message == (
        "ok, wide: start; no speed on odom within 10 s of the window; linear is a unit direction"
    )
    peer.spin_until(lambda: stamp(peer.twists[-1]) == 20_005 * MS, "its twist")
    assert peer.twists[-1].twist.linear.z == 0.8
    peer.spin_until(lambda: "no speed on odom" in peer.status()["message"], "the warning")


def test_speed_gives_the_linear_velocity_and_may_change(peer: Peer, start: Start) -> None:
    node = start(scale__source="parameter", scale__speed=5.0)
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: peer.twists and peer.covariances, "a window")
    linear = peer.twists[0].twist.linear
    np.testing.assert_allclose([linear.x, linear.y, linear.z], [0.0, 3.0, 4.0])
    assert peer.covariances[0].twist.twist == peer.twists[0].twist
    expected = np.diag([25.0, 25.0, 25.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(peer.covariances[0].twist.covariance, expected.ravel())
    node.set({"scale.source": "none"})
    run_windows(peer, 1015, 1021)
    peer.spin_until(lambda: len(peer.twists) == 2, "the next window")
    assert peer.twists[1].twist.linear.z == 0.8


def test_earlier_times_after_a_restart_count_anew(peer: Peer, start: Start) -> None:
    node = start()
    run_windows(peer, 3000, 3011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a window")
    node.activate_again()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 2, "an earlier window")
    assert stamp(peer.twists[1]) == 1005 * MS
    assert peer.covariances[-1].twist.twist.angular.y == 1  # the estimator started cold


def test_new_calibration_counts_after_a_new_activation(peer: Peer, start: Start) -> None:
    node = start()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: peer.twists, "a window")
    assert peer.twists[0].twist.angular.z == CAMERA.width
    node.activate_again()
    larger = Camera(80, 60, 50.0, 50.0, 40.0, 30.0)
    peer.publish_camera(larger)
    clock = iter(range(2000, 100_000, 5))

    def publish_until_larger() -> bool:
        peer.publish_events(next(clock) * MS, camera=larger)
        return bool(peer.twists[-1].twist.angular.z == larger.width)

    peer.spin_until(publish_until_larger, "a window with the new calibration")
