"""ROS messages from what the node knows, and back: the only place that builds messages."""

import array
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Twist, TwistStamped, TwistWithCovarianceStamped, Vector3
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from emoflow_ros.core import twist as core
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.node.statistics import Report

# Where each message has its velocity, a vector or a number of m/s.
SPEED_TYPES: dict[str, Callable[[Any], Vector3 | float]] = {
    "nav_msgs/msg/Odometry": lambda message: message.twist.twist.linear,
    "geometry_msgs/msg/TwistStamped": lambda message: message.twist.linear,
    "std_msgs/msg/Float64": lambda message: message.data,
}

_TRACK_WIDTH = 0.004  # m, at a distance of 1 m: about a pixel
_TRACK_COLOR = (1.0, 0.75, 0.1)
_TRACK_LIFETIME = Duration(sec=2)


def to_header(stamp: int, frame_id: str) -> Header:
    """Build a header from ROS time in ns."""
    sec, nanosec = divmod(stamp, NS_PER_S)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def to_twist(twist: core.Twist, header: Header) -> TwistStamped:
    """Build the twist; the angular velocity is in rad/s."""
    return TwistStamped(header=header, twist=_twist(twist))


def to_twist_with_covariance(
    twist: core.Twist, covariance: NDArray[np.float64], header: Header
) -> TwistWithCovarianceStamped:
    """Build the twist with its covariance, row-major over (linear, angular).

    covariance[0] is -1 where translation is not observable.
    """
    message = TwistWithCovarianceStamped(header=header)
    message.twist.twist = _twist(twist)
    message.twist.covariance = np.asarray(covariance, np.float64).ravel()
    return message


def to_image(pixels: NDArray[Any], encoding: str, header: Header) -> Image:
    """Build an image from pixels (height, width, ...) that are laid out as the encoding says."""
    height, width = pixels.shape[:2]
    return Image(
        header=header,
        height=height,
        width=width,
        encoding=encoding,
        is_bigendian=0,
        step=pixels.nbytes // height,
        data=array.array("B", pixels.tobytes()),
    )


def to_tracks(lines: NDArray[np.float32], header: Header) -> Marker:
    """Build a marker of line segments (S, 2, 4): x, y, z in m and opacity; it replaces the last."""
    marker = Marker(header=header, ns="tracks", type=Marker.LINE_LIST, action=Marker.ADD)
    marker.pose.orientation.w = 1.0
    marker.scale.x = _TRACK_WIDTH
    marker.lifetime = _TRACK_LIFETIME
    marker.frame_locked = True
    ends = lines.reshape(-1, 4).tolist()
    red, green, blue = _TRACK_COLOR
    marker.points = [Point(x=x, y=y, z=z) for x, y, z, _ in ends]
    marker.colors = [ColorRGBA(r=red, g=green, b=blue, a=opacity) for *_, opacity in ends]
    return marker


def to_diagnostics(name: str, report: Report, stamp: Time) -> DiagnosticArray:
    """Build the diagnostics of one node."""
    status = to_status(f"{name}: estimator", name, report)
    return DiagnosticArray(header=Header(stamp=stamp), status=[status])


def to_status(name: str, hardware_id: str, report: Report) -> DiagnosticStatus:
    """Build one status: level, message and numbers of a report."""
    return DiagnosticStatus(
        level=bytes([report.level]),
        name=name,
        message=report.message,
        hardware_id=hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in report.values.items()],
    )


def to_camera(info: CameraInfo) -> Camera:
    """Build the camera model.

    Raises:
        InputError: the camera is not calibrated, or its lens model is unknown.
    """
    return Camera.from_intrinsic_matrix(
        info.width, info.height, info.k, info.distortion_model, info.d
    )


def to_speed(message: Any, ros_type: str) -> tuple[int | None, float]:
    """Read the time of a message, ROS time in ns or None without a stamp, and its speed in m/s.

    Args:
        message: of one of SPEED_TYPES.
        ros_type: which one.
    """
    velocity = SPEED_TYPES[ros_type](message)
    if isinstance(velocity, float):
        return None, abs(velocity)
    stamp = message.header.stamp
    speed = math.hypot(velocity.x, velocity.y, velocity.z)
    return stamp.sec * NS_PER_S + stamp.nanosec or None, speed


def _twist(twist: core.Twist) -> Twist:
    return Twist(linear=_vector(twist.linear), angular=_vector(twist.angular))


def _vector(values: Sequence[float] | NDArray[np.float64]) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)
