import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TwistStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.twist import Twist
from emoflow_ros.errors import InputError
from emoflow_ros.node import converters
from emoflow_ros.node.statistics import Level, Report

HEADER = converters.to_header(1_500_000_000_123_456_789, "camera")


@pytest.fixture
def rotation() -> Twist:
    return Twist(
        t=5,
        linear=np.zeros(3),
        angular=np.array([0.1, -0.2, 0.3]),
    )


def test_header_splits_nanoseconds() -> None:
    assert (HEADER.stamp.sec, HEADER.stamp.nanosec) == (1_500_000_000, 123_456_789)
    assert converters.to_header(-1, "").stamp == Time(sec=-1, nanosec=999_999_999)


def test_twist_of_a_rotation_has_no_direction(rotation: Twist) -> None:
    message = converters.to_twist(rotation, HEADER)
    assert (message.twist.linear.x, message.twist.linear.y, message.twist.linear.z) == (0, 0, 0)
    assert message.twist.angular.y == -0.2
    assert message.header == HEADER


def test_covariance_says_that_translation_is_not_observable(rotation: Twist) -> None:
    covariance = np.zeros((6, 6))
    covariance[0, 0] = -1
    message = converters.to_twist_with_covariance(rotation, covariance, HEADER)
    assert message.twist.covariance[0] == -1
    np.testing.assert_array_equal(message.twist.covariance[1:], 0)


def test_flow_image_survives_serialisation() -> None:
    flow = np.arange(24, dtype=np.float32).reshape(3, 4, 2)
    flow[1, 2] = np.nan
    message = converters.to_image(flow, "32FC2", HEADER)
    message = deserialize_message(serialize_message(message), Image)
    assert (message.encoding, message.height, message.width) == ("32FC2", 3, 4)
    assert message.step == 4 * 2 * 4
    back = np.frombuffer(message.data, "<f4").reshape(3, 4, 2)
    np.testing.assert_array_equal(back, flow)


def test_track_marker_survives_serialisation() -> None:
    lines = np.float32([[[0.1, -0.2, 1.0, 0.25], [0.3, -0.2, 1.0, 0.75]]])
    message = converters.to_tracks(lines, HEADER)
    message = deserialize_message(serialize_message(message), Marker)
    assert (message.type, message.id, message.header) == (Marker.LINE_LIST, 0, HEADER)
    points = [(p.x, p.y, p.z) for p in message.points]
    np.testing.assert_array_equal(np.float32(points), lines[0, :, :3])
    assert [c.a for c in message.colors] == [0.25, 0.75]
    assert len({(c.r, c.g, c.b) for c in message.colors}) == 1
    assert message.lifetime.sec == 2
    assert converters.to_tracks(np.empty((0, 2, 4), np.float32), HEADER).points == []


def test_speed_of_a_message_without_a_stamp_has_no_time() -> None:
    twist = TwistStamped()
    twist.twist.linear.x, twist.twist.linear.z = -3.0, 4.0
    assert converters.to_speed(twist, "geometry_msgs/msg/TwistStamped") == (None, 5.0)
    twist.header.stamp = Time(sec=2, nanosec=5)
    assert converters.to_speed(twist, "geometry_msgs/msg/TwistStamped") == (2_000_000_005, 5.0)
    assert converters.to_speed(Float64(data=-2.0), "std_msgs/msg/Float64") == (None, 2.0)


def test_camera_info_becomes_the_camera() -> None:
    info = CameraInfo(width=64, height=48, distortion_model="plumb_bob")
    info.k = [50.0, 0.0, 32.0, 0.0, 51.0, 24.0, 0.0, 0.0, 1.0]
    info.d = [0.1, 0.2, 0.0, 0.0, 0.0]
    camera = converters.to_camera(info)
    assert camera == Camera(64, 48, 50.0, 51.0, 32.0, 24.0, "plumb_bob", (0.1, 0.2, 0.0, 0.0, 0.0))


def test_uncalibrated_camera_info_is_refused() -> None:
    with pytest.raises(InputError, match="focal lengths"):
        converters.to_camera(CameraInfo(width=64, height=48))


def test_diagnostics_hold_level_reason_and_numbers() -> None:
    report = Report(Level.WARN, "late", {"windows_ok": "3"})
    message = converters.to_diagnostics("/ns/estimator", report, Time(sec=3))
    [status] = message.status
    assert (status.level, status.message) == (b"\x01", "late")
    assert [(v.key, v.value) for v in status.values] == [("windows_ok", "3")]
    assert message.header.stamp.sec == 3
