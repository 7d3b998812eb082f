import sys

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from fake_node import install_fake_tf

from emoflow_ros.errors import InputError
from emoflow_ros.node.settings import OutputOptions
from emoflow_ros.node.target_frame import LATEST, NoTransformError, make_target_frame

OPTICAL_IN_BODY = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]


def test_without_a_target_nothing_is_rotated() -> None:
    frame = make_target_frame(None, OutputOptions(target_source="parameter", target_yaw=1.0))
    assert frame.name("optical") == "optical"
    np.testing.assert_array_equal(frame.rotation("optical", 5), np.eye(3))


def test_angles_are_those_of_a_urdf() -> None:
    """rpy="-pi/2 0 -pi/2" is what every URDF has between a camera and its optical frame."""
    options = OutputOptions(
        target_frame="base",
        target_source="parameter",
        target_roll=-np.pi / 2,
        target_yaw=-np.pi / 2,
    )
    frame = make_target_frame(None, options)
    assert frame.name("optical") == "base"
    np.testing.assert_allclose(frame.rotation("optical", 0), OPTICAL_IN_BODY, atol=1e-12)


def test_angles_turn_about_the_axes_of_the_target_in_their_order() -> None:
    roll, pitch, yaw = 0.3, -0.5, 0.7

    def turn(axis: int, angle: float) -> np.ndarray:
        c, s = np.cos(angle), np.sin(angle)
        return np.roll([[1, 0, 0], [0, c, -s], [0, s, c]], axis, (0, 1))

    options = OutputOptions(
        target_frame="base",
        target_source="parameter",
        target_roll=roll,
        target_pitch=pitch,
        target_yaw=yaw,
    )
    expected = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    np.testing.assert_allclose(make_target_frame(None, options).rotation("o", 0), expected)


def test_tf_is_asked_at_the_stamp(monkeypatch: pytest.MonkeyPatch) -> None:
    tf = install_fake_tf(monkeypatch)
    frame = make_target_frame(None, OutputOptions(target_frame="base"))
    with pytest.raises(NoTransformError, match="no transform from optical to base: not yet"):
        frame.rotation("optical", 123)
    tf.known = True
    np.testing.assert_allclose(frame.rotation("optical", 456), OPTICAL_IN_BODY, atol=1e-12)
    assert tf.asked == [("base", "optical", 123), ("base", "optical", 456)]
    assert frame.name("optical") == "base"
    frame.close()
    assert tf.listening == 0


def test_tf_of_an_earlier_run_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    tf = install_fake_tf(monkeypatch)
    tf.known = True
    frame = make_target_frame(None, OutputOptions(target_frame="base"))
    second = 1_000_000_000
    for stamp in (20 * second, 21 * second, LATEST, 21 * second - 5):
        frame.rotation("optical", stamp)
    assert tf.cleared == 0
    frame.rotation("optical", 3 * second)
    frame.rotation("optical", 4 * second)
    assert tf.cleared == 1


def test_tf_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    with pytest.raises(InputError, match="tf2_ros, which is not installed; install ros-jazzy-tf2"):
        make_target_frame(None, OutputOptions(target_frame="base"))
