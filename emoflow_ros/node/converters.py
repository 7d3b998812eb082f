"""ROS messages from what the node knows, and back: the only place that builds messages."""

import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Twist, TwistStamped, TwistWithCovarianceStamped, Vector3
from numpy.typing import NDArray
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from emoflow_ros.core import twist as core
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.node.statistics import Report


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


def _twist(twist: core.Twist) -> Twist:
    return Twist(linear=_vector(twist.linear), angular=_vector(twist.angular))


def _vector(values: Sequence[float] | NDArray[np.float64]) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)
