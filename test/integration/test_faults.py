"""Faults around the node, injected over DDS: topics, devices, clocks, subscribers, neighbours."""

import itertools
import signal
import sys

import numpy as np
import pytest
from dvs_msgs.msg import EventArray
from harness import CAMERA, MS, WAIT_S, Peer, Processes
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo
from shared_node import SharedNode

from emoflow_ros.core.geometry.camera import Camera

pytestmark = pytest.mark.dds

ACTIVATE = Transition(id=Transition.TRANSITION_ACTIVATE)
DEACTIVATE = Transition(id=Transition.TRANSITION_DEACTIVATE)
ON_CUDA = ("-p", "profile:=paper", "-p", "estimator.device:=cuda")
SMALL = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)
SUBSCRIBER = """
import rclpy
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import Image
rclpy.init()
node = rclpy.create_node("stuck")
node.create_subscription(TwistStamped, "/egomotion/twist", print, 10)
node.create_subscription(Image, "/flow/image", lambda image: None, 10)
rclpy.spin(node)
"""


def run_windows(
    peer: Peer, first_ms: int, last_ms: int, *, camera: Camera = CAMERA, pause_s: float = 0.0
) -> None:
    """Publish 5 events every 5 ms: 10 in each window of 10 ms."""
    for t in range(first_ms, last_ms, 5):
        peer.publish_events(t * MS, camera=camera)
        peer.spin_for(pause_s)


def test_simulated_time_may_stand_still(peer: Peer, processes: Processes) -> None:
    """As before a replay: the node finds the topic, estimates and reports without a /clock."""
    processes.start_fake("Recorder", "-p", "use_sim_time:=true")
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 0, 31)
    peer.spin_until(lambda: len(peer.twists) == 3, "three twists")
    assert [t.header.stamp.nanosec // MS for t in peer.twists] == [5, 15, 25]
    peer.spin_until(lambda: peer.status().get("windows_ok") == "3", "the count")
    assert peer.diagnostics[-1].header.stamp.sec == 0


def test_incompatible_qos_is_said_with_both_sides(peer: Peer, processes: Processes) -> None:
    override = "qos_overrides./events.subscription.reliability:=reliable"
    node = processes.start_fake("Recorder", "-p", override)
    peer.hear()
    said = (
        "/events: no event arrives: a publisher offers best_effort volatile, but "
        "reliable volatile is asked for; change qos_overrides./events.subscription.*"
    )
    peer.spin_until(lambda: said in processes.output(node), "the reason")
    assert peer.events.get_subscription_count() == 0
    peer.spin_until(
        lambda: peer.node.get_subscriptions_info_by_topic("/events"), "it is seen to subscribe"
    )
    [subscription] = peer.node.get_subscriptions_info_by_topic("/events")
    assert subscription.qos_profile.reliability.name == "RELIABLE"  # the override is honoured


def test_driver_that_comes_later_and_is_best_effort_is_heard(processes: Processes) -> None:
    """A reliable subscription would stay deaf to it."""
    with Peer(reliability=ReliabilityPolicy.RELIABLE) as peer:
        node = processes.start_fake("Recorder")
        peer.connect()
        peer.publish_camera()
        run_windows(peer, 1000, 1031)
        peer.spin_until(lambda: len(peer.twists) == 3, "twists of the first publisher")
        [subscription] = peer.node.get_subscriptions_info_by_topic("/events")
        assert subscription.qos_profile.reliability is ReliabilityPolicy.RELIABLE
        peer.node.destroy_publisher(peer.events)
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
        peer.events = peer.node.create_publisher(EventArray, "/events", qos)
        peer.spin_until(peer.events.get_subscription_count, "it is heard, too")
        peer.spin_until(
            lambda: "subscribed to best effort from now on" in processes.output(node), "the line"
        )
        run_windows(peer, 1035, 1066)
        peer.spin_until(lambda: len(peer.twists) >= 5, "twists of the second publisher")
        assert "no event arrives" not in peer.status()["message"]


def test_subscriber_that_never_reads_holds_up_nobody(
    peer: Peer, processes: Processes, recorder: SharedNode
) -> None:
    stuck = processes.start(sys.executable, "-c", SUBSCRIBER)
    recorder.start(peer, {"input.queue_windows": 50})
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a twist")
    peer.spin_until(lambda: peer.node.count_subscribers("/flow/image") == 1, "the subscriber")
    stuck.send_signal(signal.SIGSTOP)
    try:
        run_windows(peer, 1015, 2021, pause_s=0.01)
        peer.spin_until(lambda: len(peer.twists) == 102, "all twists")
        peer.spin_until(lambda: peer.status()["windows_ok"] == "102", "the count")
        # A write that waits takes 100 ms: windows would be dropped.
        assert peer.status()["windows_dropped"] == "0"
    finally:
        stuck.send_signal(signal.SIGCONT)


def test_camera_info_that_comes_late_finds_the_windows_waiting(
    peer: Peer, recorder: SharedNode
) -> None:
    recorder.start(peer)
    peer.connect()
    run_windows(peer, 1000, 1031)
    peer.spin_until(lambda: peer.status().get("events") == "35", "the events arrived")
    missing = "no calibration yet: publish /camera_info or give camera.calibration_file"
    assert peer.status()["message"] == missing
    peer.publish_camera()
    peer.spin_until(lambda: len(peer.twists) == 3, "the windows that waited")
    peer.spin_until(lambda: "calibration" not in peer.status()["message"], "the end of the problem")


def test_camera_info_of_another_sensor_starts_windows_anew(
    peer: Peer, recorder: SharedNode
) -> None:
    recorder.start(peer)
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a window")
    peer.publish_camera(SMALL)
    peer.spin_until(lambda: "calibration: 32x24" in recorder.output, "the new one")
    run_windows(peer, 1015, 1036, camera=SMALL)
    peer.spin_until(lambda: len(peer.twists) == 3, "two windows more")
    assert [t.twist.angular.z for t in peer.twists] == [64, 32, 32]
    assert {t.twist.angular.x for t in peer.twists} == {10}  # no window holds events of both
    assert recorder.output.count("calibration: ") == 2


def test_calibration_of_another_size_is_said_while_messages_come(
    peer: Peer, recorder: SharedNode
) -> None:
    recorder.start(peer, {"input.silence_s": 0.5})
    peer.connect()
    peer.publish_camera(SMALL)
    peer.spin_until(lambda: "calibration: 32x24" in recorder.output, "the calibration")
    run_windows(peer, 1000, 1101, pause_s=0.01)
    peer.spin_until(lambda: peer.status()["wrong_size_messages"] != "0", "the count")
    before = len(peer.diagnostics)
    run_windows(peer, 1105, 1501, pause_s=0.01)
    peer.spin_until(lambda: "nothing to use for" in peer.status()["message"], "the reason")
    reason = "messages of another sensor size: give this sensor's calibration"
    assert reason in peer.status()["message"]
    assert peer.diagnostics[-1].status[0].level == b"\x02"
    assert not [d for d in peer.diagnostics[before:] if "no events" in d.status[0].message]


@pytest.mark.parametrize(
    ("size", "reason"), [((0, 0), "size 0x0"), ((60_000, 60_000), "size 60000x60000")]
)
def test_camera_info_of_an_impossible_size_is_refused(
    peer: Peer, recorder: SharedNode, size: tuple[int, int], reason: str
) -> None:
    recorder.start(peer)
    peer.connect()
    k = [50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0]
    peer.publish_camera_info(CameraInfo(width=size[0], height=size[1], k=k))
    peer.spin_until(lambda: reason in peer.status()["message"], "the diagnosis")
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a window with the good one")


def test_malformed_messages_at_100_hz_cost_no_good_one(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer, {"input.queue_windows": 50})
    peer.connect()
    peer.publish_camera()
    rng = np.random.default_rng(3)
    for t in range(1000, 2001, 5):
        peer.publish_events(t * MS)
        peer.events.publish(b"\x00\x01\x00\x00" + rng.bytes(40))
        peer.spin_for(0.01)
    peer.spin_until(lambda: len(peer.twists) == 100, "all windows of the good messages")
    assert {t.twist.angular.x for t in peer.twists} == {10.0}
    peer.spin_until(lambda: peer.status()["malformed_messages"] == "201", "the count")
    assert recorder.output.count("malformed") <= 2  # in 2 s and more: throttled
    said = {s.message for d in peer.diagnostics for s in d.status}
    assert any("malformed messages: check the driver's message version" in m for m in said)


def test_missing_device_ends_the_start_where_the_cpu_is_refused(processes: Processes) -> None:
    node = processes.start_fake("NoCuda", *ON_CUDA, "-p", "on_missing_device:=refuse")
    assert node.wait(WAIT_S) == 2
    [line] = [x for x in processes.output(node).splitlines() if x.startswith("error: ")]
    assert "estimator.device: no CUDA device was found" in line


def test_missing_device_is_named_while_the_cpu_does_its_work(
    peer: Peer, processes: Processes
) -> None:
    processes.start_fake("NoCuda", *ON_CUDA)
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a twist")
    said = "no CUDA device was found; use cpu; estimating on the CPU"
    peer.spin_until(lambda: said in peer.status()["message"], "the warning")
    assert peer.diagnostics[-1].status[0].level == b"\x01"


def test_camera_that_starts_late_is_waited_for_in_its_namespace(processes: Processes) -> None:
    with Peer("/left/events") as left:
        node = processes.start_fake("Recorder", "-r", "__ns:=/right")
        waiting = (
            "waiting for events: nobody publishes /right/events; "
            "outside the node's namespace: /left/events"
        )
        left.spin_until(lambda: waiting in left.status()["message"], "the question")
        left.spin_for(1.5)  # longer than the graph takes to settle
        assert left.events.get_subscription_count() == 0
        with Peer("/right/events") as right:
            right.connect()
            assert left.events.get_subscription_count() == 0
        assert "listening to /right/events" in processes.output(node)
        assert "listening to /left/events" not in processes.output(node)


def test_node_that_is_activated_again_says_what_it_waits_for(processes: Processes) -> None:
    with Peer("/cam/events") as peer:
        node = processes.start_fake("Recorder")
        peer.connect()
        peer.publish_camera()
        times = itertools.count(1000, 5)
        peer.node.create_timer(0.01, lambda: peer.publish_events(next(times) * MS))
        peer.spin_until(lambda: len(peer.twists) >= 2, "twists")
        peer.call(ChangeState, "/estimator/change_state", transition=DEACTIVATE)
        peer.spin_until(lambda: "inactive" in peer.status()["message"], "its state")
        before = len(processes.output(node))
        peer.call(ChangeState, "/estimator/change_state", transition=ACTIVATE)
        settling = "waiting for events: /cam/events is taken as soon as"
        peer.spin_until(lambda: settling in peer.status()["message"], "what it waits for")
        peer.spin_until(lambda: peer.status()["message"] == "running", "it goes on")
        assert "nobody publishes" not in processes.output(node)[before:]


def test_node_that_stood_still_goes_on_with_the_newest_events(processes: Processes) -> None:
    """As under overload, messages wait that cover more event time than is worth it."""
    with Peer(reliability=ReliabilityPolicy.RELIABLE) as peer:
        node = processes.start_fake("Recorder", "-p", "input.queue_windows:=1")
        peer.connect()
        peer.publish_camera()
        run_windows(peer, 1000, 1101, pause_s=0.01)
        peer.spin_until(lambda: len(peer.twists) > 1, "windows before")
        node.send_signal(signal.SIGSTOP)
        try:
            run_windows(peer, 1105, 2001)
        finally:
            node.send_signal(signal.SIGCONT)
        peer.spin_until(lambda: peer.status()["messages_skipped"] != "0", "the gap")
        # A busy machine may leave out some of these, too: they come until one is a window's end.
        times = itertools.count(2005, 5)
        timer = peer.node.create_timer(0.01, lambda: peer.publish_events(next(times) * MS))
        peer.spin_until(lambda: peer.twists[-1].header.stamp.sec >= 2, "windows behind the gap")
        timer.cancel()
        sent = (next(times) - 1000) // 5

        def count(*names: str) -> int:
            return sum(int(peer.status()[name]) for name in names)

        peer.spin_until(lambda: count("messages", "messages_skipped") == sent, "all messages")
        assert count("messages_skipped") > 20
        assert count("seq_gaps", "time_jumps") == 0
        # None reaches over it: it would have the events of one message, 5, or 3 if that is decoded
        # in part, as on a machine that is busy with other things.
        in_part = {6.0, 8.0} if count("messages_in_part") else set()
        assert {t.twist.angular.x for t in peer.twists} - in_part == {10.0}
        assert processes.output(node).count("messages are left out, because events come") == 1
        said = {s.message for d in peer.diagnostics for s in d.status}
        assert any("messages left out: events come faster than the node" in m for m in said)
