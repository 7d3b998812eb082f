"""The node's topics: what of a window is published where."""

from contextlib import ExitStack

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import Image
from visualization_msgs.msg import Marker

from emoflow_ros.core.estimate import Status
from emoflow_ros.node import converters
from emoflow_ros.node.scale import Scale
from emoflow_ros.node.settings import NodeOptions, ScaleOptions
from emoflow_ros.node.statistics import Level, Report, Statistics
from emoflow_ros.node.target_frame import NoTransformError
from emoflow_ros.node.tasks import Picture, Result, Task, Wishes
from emoflow_ros.node.twist_output import TwistOutput, make_publisher
from emoflow_ros.node.window_status import judge_dropped, judge_failed, judge_result

_ENCODINGS = {Picture.FLOW: "32FC2", Picture.COLOR: "rgb8", Picture.EVENTS: "mono8"}


class Outputs:
    """Publishes windows on the topics of a lifecycle node, which must be active for that.

    Args:
        node: to publish with.
        options: what to publish.
        statistics: told while twists are not what was asked for.
        made: gets what takes the topics away.

    Raises:
        InputError: the options need a package that is not installed.
    """

    def __init__(
        self, node: LifecycleNode, options: NodeOptions, statistics: Statistics, made: ExitStack
    ) -> None:
        self._node = node
        self._options = options.output
        self._statistics = statistics
        self._twists = TwistOutput(node, options.output, made)
        self._scale = Scale(node, options.scale)
        made.callback(self._scale.close)
        self._status = make_publisher(node, DiagnosticStatus, "egomotion/status", made)
        self._pictures = {
            picture: make_publisher(
                node, Marker if picture is Picture.TRACKS else Image, picture, made
            )
            for picture in Picture
        }

    def set_scale(self, options: ScaleOptions) -> None:
        """Take the scale from somewhere else from now on."""
        self._scale.set_options(options)

    @property
    def wishes(self) -> Wishes:
        """What results are to hold: of the pictures those that somebody subscribes to now."""
        subscribed = (p for p in Picture if self._pictures[p].get_subscription_count() > 0)
        return Wishes(
            tuple(subscribed),
            flow_color_max=self._options.flow_color_max,
            flow_stride=self._options.flow_stride,
            tracks=self._options.tracks,
            twist_rate=self._options.twist_rate,
        )

    def publish(self, result: Result) -> None:
        """Publish a window's status, and its estimate if there is one."""
        scaling = self._scale.at(result.stamp)
        problems = {"scale": scaling.problem}
        if result.estimate.status is Status.OK:
            # Pictures first: under load twists sent before a flow image, which is larger than Fast
            # DDS's shared memory (512 KiB), came seconds late or never.
            self._publish_pictures(result)
            problems["frame"] = self._publish_twists(result, scaling.factor)
        for part, problem in problems.items():
            self._statistics.clear_problem(part)
            if problem:
                self._statistics.set_problem(part, Level.WARN, problem)
        found = [problem for problem in problems.values() if problem]
        self._publish_status(judge_result(result, self._now(), scaling.source, found))

    def publish_dropped(self, task: Task, reason: str) -> None:
        """Publish the status of a window that had to make room for this reason."""
        self._publish_status(judge_dropped(task, reason, self._now()))

    def publish_failed(self, task: Task, reason: str) -> None:
        """Publish the status of a window that the worker failed at."""
        self._publish_status(judge_failed(task, reason, self._now()))

    def _publish_twists(self, result: Result, factor: float) -> str:
        """Publish the twists, or say why not."""
        try:
            self._twists.publish(result, factor)
        except NoTransformError as error:
            return f"{error}; no twist is published"
        return ""

    def _publish_pictures(self, result: Result) -> None:
        header = converters.to_header(result.stamp, result.task.frame_id)
        for name, drawn in result.pictures.items():
            picture = Picture(name)
            if picture is Picture.TRACKS:
                message = converters.to_tracks(drawn, header)
            else:
                message = converters.to_image(drawn, _ENCODINGS[picture], header)
            self._pictures[picture].publish(message)

    def _publish_status(self, report: Report) -> None:
        name = self._node.get_fully_qualified_name()
        self._status.publish(converters.to_status(f"{name}: window", name, report))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
