"""The node's topics: what of a window is published where."""

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TwistStamped, TwistWithCovarianceStamped
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import Image

from emoflow_ros.core.estimate import Status
from emoflow_ros.node import converters
from emoflow_ros.node.statistics import Report
from emoflow_ros.node.tasks import Result, Task
from emoflow_ros.node.window_status import judge_dropped, judge_failed, judge_result

_DEPTH = 10


class Outputs:
    """Publishes windows on the topics of a lifecycle node, which must be active for that.

    Args:
        node: to publish with.
    """

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._twist = node.create_lifecycle_publisher(TwistStamped, "egomotion/twist", _DEPTH)
        self._twist_with_covariance = node.create_lifecycle_publisher(
            TwistWithCovarianceStamped, "egomotion/twist_with_covariance", _DEPTH
        )
        self._status = node.create_lifecycle_publisher(DiagnosticStatus, "egomotion/status", _DEPTH)
        self._flow = node.create_lifecycle_publisher(Image, "flow/image", _DEPTH)

    def destroy(self) -> None:
        """Take the topics away."""
        for publisher in (self._twist, self._twist_with_covariance, self._status, self._flow):
            self._node.destroy_lifecycle_publisher(publisher)

    @property
    def flow_wanted(self) -> bool:
        """Whether somebody subscribes to the flow."""
        return self._flow.get_subscription_count() > 0

    def publish(self, result: Result) -> None:
        """Publish a window's status, and its estimate if there is one."""
        self._publish_status(judge_result(result, self._now()))
        estimate = result.estimate
        if estimate.status is not Status.OK:
            return
        header = converters.to_header(result.stamp, result.task.frame_id)
        self._twist.publish(converters.to_twist(estimate, header))
        self._twist_with_covariance.publish(converters.to_twist_with_covariance(estimate, header))
        if result.flow is not None:
            self._flow.publish(converters.to_flow_image(result.flow, header))

    def publish_dropped(self, task: Task) -> None:
        """Publish the status of a window that had to make room."""
        self._publish_status(judge_dropped(task, self._now()))

    def publish_failed(self, task: Task, reason: str) -> None:
        """Publish the status of a window that the worker failed at."""
        self._publish_status(judge_failed(task, reason, self._now()))

    def _publish_status(self, report: Report) -> None:
        name = self._node.get_fully_qualified_name()
        self._status.publish(converters.to_status(f"{name}: window", name, report))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
