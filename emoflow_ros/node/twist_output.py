"""The egomotion's topics: twists at the scale and in the frame that were asked for."""

from contextlib import ExitStack
from typing import Any

from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode

from emoflow_ros.core.twist import Twist, at_middle, covariance_at_speed, covariance_in_frame
from emoflow_ros.node import converters
from emoflow_ros.node.settings import OutputOptions
from emoflow_ros.node.target_frame import Matrix, make_target_frame
from emoflow_ros.node.tasks import Result

_DEPTH = 10


def make_publisher(node: LifecycleNode, message_type: Any, topic: str, made: ExitStack) -> Any:
    """Make a publisher that publishes while the node is active; `made` gets what takes it away."""
    publisher = node.create_lifecycle_publisher(message_type, topic, _DEPTH)
    made.callback(node.destroy_lifecycle_publisher, publisher)
    return publisher


class TwistOutput:
    """Publishes twists with stamps that increase, also where the clocks' offset is corrected.

    Args:
        node: to publish with.
        options: in which frame.
        made: gets what takes the topics away.

    Raises:
        InputError: tf is asked for and not installed.
    """

    def __init__(self, node: LifecycleNode, options: OutputOptions, made: ExitStack) -> None:
        self._frame = make_target_frame(node, options)
        made.callback(self._frame.close)
        self._last = (-1, 0)  # epoch and stamp
        self._twist = make_publisher(node, TwistStamped, "egomotion/twist", made)
        self._with_covariance = make_publisher(
            node, TwistWithCovarianceStamped, "egomotion/twist_with_covariance", made
        )

    def publish(self, result: Result, factor: float) -> None:
        """Publish a window's twists, their linear part times this factor.

        Raises:
            NoTransformError: the rotation into the frame is not known at the window's time.
        """
        rotation = self._frame.rotation(result.task.frame_id, result.stamp)
        for twist in result.twists:
            self._publish_increasing(result, twist.at_speed(factor).in_frame(rotation))
        self._publish_with_covariance(result, factor, rotation)

    def _publish_increasing(self, result: Result, twist: Twist) -> None:
        task = result.task
        stamp = task.to_ros(twist.t)
        if (task.epoch, stamp) > self._last:
            self._last = (task.epoch, stamp)
            header = converters.to_header(stamp, self._frame.name(task.frame_id))
            self._twist.publish(converters.to_twist(twist, header))

    def _publish_with_covariance(self, result: Result, factor: float, rotation: Matrix) -> None:
        middle = at_middle(result.estimate).at_speed(factor).in_frame(rotation)
        covariance = covariance_at_speed(result.estimate.covariance, factor)
        covariance = covariance_in_frame(covariance, rotation)
        header = converters.to_header(result.stamp, self._frame.name(result.task.frame_id))
        self._with_covariance.publish(
            converters.to_twist_with_covariance(middle, covariance, header)
        )
