"""What the node refuses over DDS, and in how many lines it says so."""

import importlib.util
from pathlib import Path

import pytest
from harness import CAMERA, MS, WAIT_S, Peer, Processes
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from repeated import results
from shared_node import SharedNode

from emoflow_ros.core.geometry.camera import Camera

pytestmark = pytest.mark.dds

SMALL = Camera(32, 24, 20.0, 20.0, 16.0, 12.0)


def run_windows(peer: Peer, first_ms: int, last_ms: int, camera: Camera = CAMERA) -> None:
    """Publish 5 events every 5 ms: 10 in each window of 10 ms."""
    for t in range(first_ms, last_ms, 5):
        peer.publish_events(t * MS, camera=camera)


REFUSALS = [
    (
        ["-p", "window.duration_ms:=-5.0"],
        "error: window.duration_ms: -5.0 is out of range; use 1 to 10000",
    ),
    (
        ["-p", "window.durations_ms:=5.0"],
        "error: window.durations_ms: no such option, the nearest is window.duration_ms; known",
    ),
    (
        ["-p", "input.type:=dvs_msgs/EventArray"],
        "error: input.type: there is no decoder for messages of type 'dvs_msgs/EventArray'; use "
        "one of",
    ),
    (
        ["-p", "camera.calibration_file:=/nowhere.yaml"],
        "error: /nowhere.yaml: no such file or directory; give a calibration file",
    ),
    (["-p", "profile:=warp"], "error: profile: unknown profile 'warp'; use one of"),
    (["-p", "use_sim_time:=foo"], "error: use_sim_time: 'foo' is not of type bool; correct"),
    (["-p", "nocolon"], "error: -p nocolon: not of the form NAME:=VALUE; write -p NAME:=VALUE"),
]


def refusals(*arguments: list[str]) -> list[str]:
    """The single line that the node says to each of these arguments."""
    given = [["--ros-args", *some] for some in arguments]
    found = results("emoflow_ros.node.executable:main", given)
    assert [code for code, _ in found] == [2] * len(given), found
    return [said for _, [said] in found]


def test_bad_parameters_are_refused_in_one_line() -> None:
    said = refusals(*(arguments for arguments, _ in REFUSALS))
    for found, (_, line) in zip(said, REFUSALS, strict=True):
        assert found.startswith(line)


def test_file_that_is_not_yaml_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "broken.yaml"
    path.write_text("estimator: [1\n  ros__parameters: 2\n")
    [said] = refusals(["--params-file", str(path)])
    assert said.startswith(f"error: --params-file {path}: holds no parameters (")
    assert said.endswith("give a YAML file of ROS parameters, as `ros2 param dump` writes it")


def test_bad_qos_override_ends_the_node_in_one_line(processes: Processes) -> None:
    node = processes.start_fake(
        "Recorder",
        *("-p", "input.type:=dvs_msgs/msg/EventArray"),
        *("-p", "qos_overrides./events.subscription.reliability:=foo"),
    )
    assert node.wait(WAIT_S) == 2
    lines = [line for line in processes.output(node).splitlines() if "[INFO]" not in line]
    assert lines == [
        "error: qos_overrides.*.reliability: 'foo' is no such policy; correct the value"
    ]


def test_missing_calibration_is_logged_once_windows_wait(peer: Peer, processes: Processes) -> None:
    node = processes.start_fake("Recorder", "-r", "camera_info:=/calibration")
    peer.hear()
    peer.spin_until(peer.events.get_subscription_count, "the node listens")
    peer.publish_events(1000 * MS)
    peer.spin_until(lambda: peer.status().get("events") == "5", "the events arrived")
    assert "windows wait" not in processes.output(node)
    run_windows(peer, 1005, 1031)
    peer.spin_until(lambda: peer.status().get("events") == "35", "more events arrived")
    line = "no calibration yet: publish /calibration or give camera.calibration_file"
    assert peer.status()["message"] == line
    said = [text for text in processes.output(node).splitlines() if "calibration" in text]
    assert len(said) == 1  # three windows, throttled
    assert said[0].startswith("[WARN]")
    assert said[0].endswith(f"windows wait: {line}")


def test_configuring_that_fails_takes_everything_back(peer: Peer, processes: Processes) -> None:
    """As with a target frame and without tf2_ros; the node is configured once that is mended."""
    node = processes.start_fake(
        "Recorder", "-p", "autostart:=false", "-p", "output.target_frame:=base_link"
    )

    def change(transition: int) -> bool:
        wish = Transition(id=transition)
        return bool(peer.call(ChangeState, "/estimator/change_state", transition=wish).success)

    if importlib.util.find_spec("tf2_ros"):
        pytest.skip("tf2_ros is installed")
    assert not change(Transition.TRANSITION_CONFIGURE)
    assert "tf needs the package tf2_ros" in processes.output(node)
    mended = [Parameter("output.target_frame", value="").to_parameter_msg()]
    answer = peer.call(SetParameters, "/estimator/set_parameters", parameters=mended)
    assert [result.reason for result in answer.results] == [""]
    assert change(Transition.TRANSITION_CONFIGURE)
    assert change(Transition.TRANSITION_INACTIVE_SHUTDOWN)
    assert processes.output(node).count("[ERROR]") == 1


def test_another_sensor_is_refused_before_a_calibration(peer: Peer, recorder: SharedNode) -> None:
    recorder.start(peer)
    peer.connect()
    run_windows(peer, 1000, 1016, camera=SMALL)  # one window, and half of the next one
    peer.spin_until(lambda: peer.status().get("events") == "20", "the events arrived")
    run_windows(peer, 1016, 1027)
    peer.spin_until(lambda: peer.status().get("wrong_size_messages") == "3", "the count")
    refusal = "events of a 64x48 sensor are left out: those before were of a 32x24 one"
    assert recorder.output.count(refusal) == 1
    assert peer.status()["events"] == "20"

    peer.publish_camera()  # of the larger one: what waited is not its own
    peer.spin_until(lambda: "calibration: 64x48" in recorder.output, "the calibration")
    run_windows(peer, 1030, 1051)
    peer.spin_until(lambda: len(peer.twists) == 2, "its own windows")
    assert [t.header.stamp.nanosec for t in peer.twists] == [35 * MS, 45 * MS]
    assert {t.twist.angular.x for t in peer.twists} == {10}
