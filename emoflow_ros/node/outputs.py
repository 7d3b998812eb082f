"""The node's topics: what of a window is published where."""

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import Image

from emoflow_ros.core.estimate import Status
from emoflow_ros.core.twist import at_middle, covariance_at_speed
from emoflow_ros.node import converters
from emoflow_ros.node.parameters import OutputOptions, ScaleOptions
from emoflow_ros.node.pictures import ENCODINGS, Picture
from emoflow_ros.node.statistics import Report
from emoflow_ros.node.tasks import Result, Task, Wishes
from emoflow_ros.node.window_status import judge_dropped, judge_failed, judge_result

_DEPTH = 10


class Outputs:
    """Publishes windows on the topics of a lifecycle node, which must be active for that.

    Args:
        node: to publish with.
        options: what to publish.
    """

    def __init__(self, node: LifecycleNode, options: OutputOptions) -> None:
        self._node = node
        self._options = options
        self._last_twist = (-1, 0)  # epoch and stamp
        self._twist = node.create_lifecycle_publisher(TwistStamped, "egomotion/twist", _DEPTH)
        self._twist_with_covariance = node.create_lifecycle_publisher(
            TwistWithCovarianceStamped, "egomotion/twist_with_covariance", _DEPTH
        )
        self._status = node.create_lifecycle_publisher(DiagnosticStatus, "egomotion/status", _DEPTH)
        self._pictures = {
            picture: node.create_lifecycle_publisher(Image, picture, _DEPTH) for picture in Picture
        }

    def destroy(self) -> None:
        """Take the topics away."""
        for publisher in (self._twist, self._twist_with_covariance, self._status):
            self._node.destroy_lifecycle_publisher(publisher)
        for publisher in self._pictures.values():
            self._node.destroy_lifecycle_publisher(publisher)

    @property
    def wishes(self) -> Wishes:
        """What results are to hold: of the pictures those that somebody subscribes to now."""
        subscribed = (p for p in Picture if self._pictures[p].get_subscription_count() > 0)
        return Wishes(tuple(subscribed), self._options.flow_color_max, self._options.twist_rate)

    def publish(self, result: Result, scale: ScaleOptions) -> None:
        """Publish a window's status, and its estimate, at this scale, if there is one."""
        self._publish_status(judge_result(result, self._now()))
        estimate = result.estimate
        if estimate.status is not Status.OK:
            return
        self._publish_twists(result, scale.factor)
        header = converters.to_header(result.stamp, result.task.frame_id)
        middle = at_middle(estimate).at_speed(scale.factor)
        covariance = covariance_at_speed(estimate.covariance, scale.factor)
        self._twist_with_covariance.publish(
            converters.to_twist_with_covariance(middle, covariance, header)
        )
        for picture, pixels in result.pictures.items():
            image = converters.to_image(pixels, ENCODINGS[Picture(picture)], header)
            self._pictures[Picture(picture)].publish(image)

    def publish_dropped(self, task: Task) -> None:
        """Publish the status of a window that had to make room."""
        self._publish_status(judge_dropped(task, self._now()))

    def publish_failed(self, task: Task, reason: str) -> None:
        """Publish the status of a window that the worker failed at."""
        self._publish_status(judge_failed(task, reason, self._now()))

    def _publish_twists(self, result: Result, factor: float) -> None:
        """Publish twists with stamps that increase, also where the clocks' offset is corrected."""
        task = result.task
        for twist in result.twists:
            stamp = task.to_ros(twist.t)
            if (task.epoch, stamp) > self._last_twist:
                self._last_twist = (task.epoch, stamp)
                header = converters.to_header(stamp, task.frame_id)
                self._twist.publish(converters.to_twist(twist.at_speed(factor), header))

    def _publish_status(self, report: Report) -> None:
        name = self._node.get_fully_qualified_name()
        self._status.publish(converters.to_status(f"{name}: window", name, report))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
