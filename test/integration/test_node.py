"""The node over DDS, with estimators that show what arrived at them."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest
from harness import (
    CAMERA,
    MS,
    WAIT_S,
    Peer,
    Processes,
    children,
    run_windows,
    wait_for,
)
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from shared_node import NAME, SharedNode

from emoflow_ros.core.geometry.camera import Camera

pytestmark = pytest.mark.dds


def stamp(message: object) -> int:
    time_ = message.header.stamp
    return time_.sec * 1_000_000_000 + time_.nanosec


def stamp_ms(peer: Peer) -> int:
    """Stamp of the latest twist, 0 without any."""
    return stamp(peer.twists[-1]) // MS if peer.twists else 0


def test_twist_holds_what_the_estimator_said(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer)
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1031)
    peer.spin_until(lambda: len(peer.twists) == 3, "three twists")
    assert [stamp(t) for t in peer.twists] == [1005 * MS, 1015 * MS, 1025 * MS]
    first = peer.twists[0]
    assert first.header.frame_id == "davis_left_optical"
    linear, angular = first.twist.linear, first.twist.angular
    assert (linear.x, linear.y, linear.z) == (0.0, 0.6, 0.8)
    assert (angular.x, angular.y, angular.z) == (10, 1, CAMERA.width)
    peer.spin_until(lambda: len(peer.covariances) == 3, "three twists with covariance")
    assert peer.covariances[0].header == first.header
    assert peer.covariances[0].twist.twist == first.twist
    expected = np.eye(6)
    expected[:3, :3] += 1e6 * np.outer((0.0, 0.6, 0.8), (0.0, 0.6, 0.8))  # its length is no speed
    np.testing.assert_allclose(peer.covariances[0].twist.covariance, expected.ravel(), rtol=1e-12)


@pytest.mark.parametrize("stride", [1, 3])
def test_flow_image_is_in_pixels_per_second(peer: Peer, recorder: SharedNode, stride: int) -> None:
    peer.subscribe_flow()
    recorder.start(peer, {"camera.frame_id": "my_frame", "output.flow_stride": stride})
    peer.connect()
    peer.publish_camera()

    clock = iter(range(1000, 10_000, 5))

    def publish_until_image() -> bool:
        peer.publish_events(next(clock) * MS)
        return bool(peer.images)

    peer.spin_until(publish_until_image, "a flow image")
    image = peer.images[0]
    width, height = -(-64 // stride), 48 // stride
    assert (image.encoding, image.width, image.height) == ("32FC2", width, height)
    assert image.step == 8 * width
    assert image.header.frame_id == "my_frame"
    flow = np.frombuffer(image.data, "<f4").reshape(height, width, 2)
    assert np.isnan(flow[:, 0]).all()
    np.testing.assert_array_equal(flow[:, 1:], np.tile(np.float32([1, -2]), (height, width - 1, 1)))


@pytest.mark.parametrize("wish", [signal.SIGINT, signal.SIGTERM])
def test_signal_ends_the_node_mid_optimisation(
    peer: Peer, processes: Processes, wish: signal.Signals
) -> None:
    node = processes.start_fake("Busy")
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1031)
    peer.spin_until(lambda: peer.status().get("events") == "35", "the events arrived")
    descendants = _descendants(node.pid)
    assert descendants
    os.killpg(node.pid, wish) if wish is signal.SIGINT else node.send_signal(wish)
    assert node.wait(WAIT_S) == 0  # the worker would be busy for ever
    wait_for(lambda: not any(map(psutil.pid_exists, descendants)), "no process is left")
    assert "Traceback" not in processes.output(node)


def takes_signals(pid: int) -> bool:
    """Whether the process blocks SIGINT, which is the first thing it does."""
    status = Path(f"/proc/{pid}/status").read_text()
    blocked = int(status.partition("SigBlk:")[2].split()[0], 16)
    return bool(blocked >> (signal.SIGINT - 1) & 1)


@pytest.mark.parametrize("stage", [takes_signals, children], ids=["imports", "fork_server"])
def test_two_interrupts_while_starting_end_the_node_in_one_line(
    processes: Processes, stage: Callable[[int], object]
) -> None:
    node = processes.start_node()
    wait_for(lambda: stage(node.pid), "the stage")
    descendants = _descendants(node.pid)
    for _ in range(2):  # of the terminal and of ros2 launch
        os.killpg(node.pid, signal.SIGINT)
    assert node.wait(WAIT_S) == 0
    said = [line for line in processes.output(node).splitlines() if "[INFO]" not in line]
    assert said == ["SIGINT: the node ends"]
    wait_for(lambda: not any(map(psutil.pid_exists, descendants)), "no process is left")


def test_malformed_messages_among_good_ones(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer, {"input.queue_windows": 20})
    peer.connect()
    peer.publish_camera()
    rng = np.random.default_rng(3)
    for t in range(1000, 1101, 5):
        peer.publish_events(t * MS)
        peer.events.publish(b"\x00\x01\x00\x00" + rng.bytes(40))
        peer.events.publish(b"\x00")
    peer.spin_until(lambda: len(peer.twists) == 10, "all windows of the good messages")
    assert {t.twist.angular.x for t in peer.twists} == {10.0}
    peer.spin_until(lambda: peer.status().get("malformed_messages") == "42", "the count")
    assert recorder.output.count("malformed") == 1  # throttled
    assert recorder.is_running


def test_jump_back_in_time_resets_once(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer)
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 5000, 5021)
    peer.spin_until(lambda: len(peer.twists) == 2, "windows before the jump")
    run_windows(peer, 1000, 1021)
    peer.spin_until(lambda: len(peer.twists) == 4, "windows after the jump")
    assert [stamp(t) // MS for t in peer.twists] == [5005, 5015, 1005, 1015]
    assert [t.twist.angular.y for t in peer.twists] == [1, 2, 1, 2]  # cold after the jump
    assert recorder.output.count("event time went back") == 1


def test_silence_warns_and_ends_without_a_restart(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer, {"input.silence_s": 0.5})
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: "no events for" in peer.status()["message"], "the warning")
    clock = iter(range(1015, 100_000, 5))

    def recovered() -> bool:
        peer.publish_events(next(clock) * MS)
        return peer.status()["message"] == "running"

    peer.spin_until(recovered, "the recovery")
    peer.spin_until(lambda: len(peer.twists) >= 2, "windows before and after the silence")


def test_window_length_changes_at_the_next_window(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer)
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a window of 10 ms")
    recorder.set({"window.duration_ms": 20.0})
    run_windows(peer, 1015, 1041)
    peer.spin_until(lambda: len(peer.twists) == 2, "a window of 20 ms")
    assert stamp_ms(peer) == 1025


def test_managed_node_goes_through_its_states(peer: Peer, processes: Processes) -> None:
    node = processes.start_fake("Recorder", "-p", "autostart:=false")

    def change(transition: int) -> bool:
        wish = Transition(id=transition)
        return peer.call(ChangeState, "/estimator/change_state", transition=wish).success

    for _ in range(2):
        assert change(Transition.TRANSITION_CONFIGURE)
        assert change(Transition.TRANSITION_ACTIVATE)
        peer.connect()
        peer.publish_camera()
        seen = len(peer.twists)
        run_windows(peer, 1000, 1011)
        peer.spin_until(lambda: len(peer.twists) == seen + 1, "a twist while active")  # noqa: B023
        assert change(Transition.TRANSITION_DEACTIVATE)
        peer.spin_until(lambda: peer.events.get_subscription_count() == 0, "it listens no more")
        workers = set(_descendants(node.pid))
        assert change(Transition.TRANSITION_CLEANUP)
        peer.spin_until(lambda: not peer.node.count_publishers("/egomotion/twist"), "no topics")
        peer.spin_until(lambda: set(_descendants(node.pid)) < workers, "no worker")  # noqa: B023


def test_impossible_transition_does_not_end_the_node(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer)
    peer.connect()
    for wish in (Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE, 250):
        transition = Transition(id=wish)
        assert not peer.call(ChangeState, f"/{NAME}/change_state", transition=transition).success
        line = f"transition {wish} is refused: the node is active; possible: deactivate (4)"
        peer.spin_until(lambda: line in recorder.output, "the refusal")  # noqa: B023
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a twist afterwards")


def test_events_of_another_sensor_are_refused(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer)
    peer.connect()
    peer.publish_camera()
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: len(peer.twists) == 1, "a window")
    peer.publish_events(1011 * MS, camera=Camera(32, 24, 20.0, 20.0, 16.0, 12.0))
    peer.spin_until(lambda: peer.status().get("wrong_size_messages") == "1", "the count")
    assert "events of a 32x24 sensor do not fit the calibration of a 64x48 one" in recorder.output


def test_uncalibrated_camera_info_is_named_and_a_good_one_accepted(
    peer: Peer, recorder: SharedNode
) -> None:
    recorder.start(peer)
    peer.connect()
    info = peer.camera_info.msg_type(width=64, height=48)  # K is zero
    peer.publish_camera_info(info)
    run_windows(peer, 1000, 1011)
    peer.spin_until(lambda: "K is zero" in peer.status()["message"], "the diagnosis")
    peer.publish_camera()
    peer.spin_until(lambda: len(peer.twists) == 1, "the window that waited")
    assert recorder.output.count("[shared]: /camera_info: K is zero") == 1


def test_second_event_topic_opens_the_choice_until_events_flow(processes: Processes) -> None:
    with Peer("/cam/events") as peer:
        with Peer("/other/events"):  # there before the node is
            node = processes.start_fake("Recorder")
            peer.spin_until(lambda: "2 event topics" in peer.status()["message"], "the question")
            assert "/cam/events, /other/events; choose with --ros-args -r events:=/cam/events" in (
                processes.output(node)
            )
        peer.connect()
        peer.spin_until(lambda: "no calibration" in peer.status()["message"], "the answer")
        with Peer("/other/events"):  # and once more, before the first event
            peer.spin_until(lambda: "2 event topics" in peer.status()["message"], "the question")
            assert peer.events.get_subscription_count() == 0
        peer.connect()
        peer.publish_camera()
        run_windows(peer, 1000, 1011)
        peer.spin_until(lambda: len(peer.twists) == 1, "a twist")
        with Peer("/other/events"):
            question = "event topics besides it: /other/events; choose with"
            peer.spin_until(lambda: question in processes.output(node), "the warning")
            run_windows(peer, 1015, 1021)
            peer.spin_until(lambda: len(peer.twists) == 2, "it goes on")


def test_remapped_topic_is_taken(processes: Processes) -> None:
    with Peer("/cam/events") as peer, Peer("/other/events") as other:
        node = processes.start_fake("Recorder", "-r", "events:=/other/events")
        other.connect()
        assert peer.events.get_subscription_count() == 0
        assert "listening to /other/events (dvs_msgs/msg/EventArray)" in processes.output(node)


def _descendants(pid: int) -> list[int]:
    direct = children(pid)
    return direct + [below for child in direct for below in _descendants(child)]
