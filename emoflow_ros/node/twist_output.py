"""The egomotion's topics: twists, at the scale and in the frame that were asked for."""

from collections.abc import Sequence
from contextlib import ExitStack
from enum import StrEnum
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs import msg
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped, Vector3
from numpy.typing import NDArray
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Header

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.twist import PresentTwist, Twist, at_middle, covariance_in_frame
from emoflow_ros.node.linear_covariance import published_covariance
from emoflow_ros.node.settings import OutputOptions
from emoflow_ros.node.target_frame import LATEST, Matrix, make_target_frame
from emoflow_ros.node.tasks import Present, Result, Task

_DEPTH = 10


class HeldBack(StrEnum):
    """What of a motion is wider than the output's bounds."""

    NOTHING = ""
    TWIST = "held back: wider than output.max_angular_sd"
    DIRECTION = "direction held back: wider than output.max_direction_sd"


class TwistOutput:
    """Publishes twists with stamps that increase, also where the clocks' offset is corrected.

    Args:
        node: to publish with.
        options: in which frame, how wide, and how the covariance says that nothing is known.
        made: gets the calls that take the topics away.
        present: whether latest twists will come; else `egomotion/twist` carries the windows'.

    Raises:
        InputError: tf is asked for and not installed.
    """

    def __init__(
        self, node: LifecycleNode, options: OutputOptions, made: ExitStack, *, present: bool
    ) -> None:
        self._frame = make_target_frame(node, options)
        made.callback(self._frame.close)
        self._form = options.linear_covariance
        self._bounds = options.bounds
        self._last = (-1, 0)  # epoch and stamp
        self._twist = make_publisher(node, TwistStamped, "egomotion/twist", made)
        kind = TwistWithCovarianceStamped
        self._of_windows = make_publisher(node, kind, "egomotion/twist_with_covariance", made)
        self._of_now = make_publisher(node, kind, "egomotion/twist_now", made) if present else None

    def publish(self, result: Result, speed: float | None) -> HeldBack:
        """Publish a window's twist at this speed, m/s, or with a unit direction.

        Returns:
            What is held back.

        Raises:
            NoTransformError: the rotation into the frame is not known at the window's time.
        """
        rotation = self._frame.rotation(result.task.frame_id, result.stamp)
        whole = PresentTwist(at_middle(result.estimate), result.estimate.covariance)
        found = self._bounds.apply(whole)
        if found is None:
            return HeldBack.TWIST
        message = self._to_message(result.task, result.stamp, found, speed, rotation)
        if self._of_now is None:
            self._publish_increasing(result.task, message)
        self._of_windows.publish(message)
        return HeldBack.NOTHING if found is whole else HeldBack.DIRECTION

    def publish_present(self, present: Present, speed: float | None) -> bool:
        """Publish the latest twist, in the same way, if it is the newest.

        Returns:
            Whether it is published: neither too late nor held back.

        Raises:
            NoTransformError: the rotation into the frame is not known.
        """
        assert self._of_now is not None
        task, found = present.task, self._bounds.apply(present.found)
        if found is None:
            return False
        rotation = self._frame.rotation(task.frame_id, LATEST)  # tf comes later than events
        message = self._to_message(task, task.to_ros(found.twist.t), found, speed, rotation)
        is_newest = self._publish_increasing(task, message)
        if is_newest:
            self._of_now.publish(message)
        return is_newest

    def _publish_increasing(self, task: Task, message: TwistWithCovarianceStamped) -> bool:
        stamp = (task.epoch, to_ns(message.header.stamp))
        if stamp <= self._last:
            return False
        self._last = stamp
        self._twist.publish(TwistStamped(header=message.header, twist=message.twist.twist))
        return True

    def _to_message(
        self, task: Task, stamp: int, found: PresentTwist, speed: float | None, rotation: Matrix
    ) -> TwistWithCovarianceStamped:
        twist = found.twist if speed is None else found.twist.at_speed(speed)
        direction = found.twist.linear
        covariance = published_covariance(found.covariance, direction, speed, self._form)
        covariance = covariance_in_frame(covariance, rotation)
        header = to_header(stamp, self._frame.name(task.frame_id))
        return to_twist_with_covariance(twist.in_frame(rotation), covariance, header)


def make_publisher(node: LifecycleNode, message_type: Any, topic: str, made: ExitStack) -> Any:
    """Make a publisher that works while the node is active; `made` gets what destroys it."""
    # rclpy's reports of subscriptions whose QoS does not match cost time in each turn of the
    # executor. Subscribers report the same.
    silent = PublisherEventCallbacks(use_default_callbacks=False)
    publisher = node.create_lifecycle_publisher(message_type, topic, _DEPTH, event_callbacks=silent)
    made.callback(node.destroy_lifecycle_publisher, publisher)
    return publisher


def to_header(stamp: int, frame_id: str) -> Header:
    """Build a header from ROS time in ns."""
    sec, nanosec = divmod(stamp, NS_PER_S)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def to_ns(stamp: Time) -> int:
    """ROS time in ns."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def to_twist_with_covariance(
    twist: Twist, covariance: NDArray[np.float64], header: Header
) -> TwistWithCovarianceStamped:
    """Build the twist with its covariance, row-major over (linear, angular)."""
    message = TwistWithCovarianceStamped(header=header)
    message.twist.twist = _twist(twist)
    message.twist.covariance = np.asarray(covariance, np.float64).ravel()
    return message


def _twist(twist: Twist) -> msg.Twist:
    return msg.Twist(linear=_vector(twist.linear), angular=_vector(twist.angular))


def _vector(values: Sequence[float] | NDArray[np.float64]) -> Vector3:
    x, y, z = map(float, values)
    return Vector3(x=x, y=y, z=z)
