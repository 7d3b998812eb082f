"""The node's subscriptions: finds the event topic and the camera_info beside it."""

from collections.abc import Callable
from dataclasses import dataclass

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo

from emoflow_ros.errors import InputError
from emoflow_ros.node.discovery import EventTopic, find_event_topic, import_message_type
from emoflow_ros.node.statistics import Level, Statistics

_EVENT_DEPTH = 1000  # as event camera drivers publish
_CAMERA_INFO_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
_LOOK_S = 0.1
_LOOKS_TO_SETTLE = 5  # the graph is discovered piece by piece
_THROTTLE_S = 5.0


@dataclass(frozen=True)
class Callbacks:
    """Who gets what.

    Attributes:
        topic: told once which topic was found.
        events: each serialised event message.
        camera_info: each calibration; None if the node has one.
    """

    topic: Callable[[EventTopic], None]
    events: Callable[[bytes], None]
    camera_info: Callable[[CameraInfo], None] | None


class EventSource:
    """Looks for the event topic until it is there, then subscribes.

    Args:
        node: to subscribe with.
        wanted_type: the parameter `input.type`.
        is_ready: whether messages can be taken yet.
        callbacks: who gets what.
        statistics: told while there is no topic.
    """

    def __init__(
        self,
        node: Node,
        *,
        wanted_type: str,
        is_ready: Callable[[], bool],
        callbacks: Callbacks,
        statistics: Statistics,
    ) -> None:
        self._node = node
        self._wanted_type = wanted_type
        self._is_ready = is_ready
        self._callbacks = callbacks
        self._statistics = statistics
        self._subscriptions: list[Subscription] = []
        self._candidate: EventTopic | None = None
        self._looks = 0
        self._timer = node.create_timer(_LOOK_S, self._look)

    def stop(self) -> None:
        """Unsubscribe, or look no longer."""
        self._node.destroy_timer(self._timer)
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)
        self._statistics.clear_problem("input")

    def _look(self) -> None:
        if not self._is_ready():
            self._statistics.set_problem("input", Level.WARN, "the worker is starting")
            return
        try:
            topic = find_event_topic(self._node, self._wanted_type)
            if topic is not None and self._is_settled(topic):
                self._subscribe(topic)
        except InputError as error:
            self._statistics.set_problem("input", Level.ERROR, str(error))
            self._node.get_logger().error(str(error), throttle_duration_sec=_THROTTLE_S)
            return
        if topic is None:
            name = self._node.resolve_topic_name("events")
            waiting = f"waiting for events: nobody publishes {name}"
            self._statistics.set_problem("input", Level.WARN, waiting)
            self._node.get_logger().info(waiting, throttle_duration_sec=_THROTTLE_S)

    def _is_settled(self, topic: EventTopic) -> bool:
        """Whether to take the topic: one that was not asked for must stay the only one."""
        self._looks = self._looks + 1 if topic == self._candidate else 0
        self._candidate = topic
        asked_for = topic.name == self._node.resolve_topic_name("events")
        return asked_for or self._looks >= _LOOKS_TO_SETTLE

    def _subscribe(self, topic: EventTopic) -> None:
        message_type = import_message_type(topic.type)
        self._node.destroy_timer(self._timer)
        self._statistics.clear_problem("input")
        self._callbacks.topic(topic)
        if self._callbacks.camera_info is not None:
            self._subscriptions.append(
                self._node.create_subscription(
                    CameraInfo,
                    camera_info_topic(self._node, topic),
                    self._callbacks.camera_info,
                    _CAMERA_INFO_QOS,
                    qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                )
            )
        self._subscriptions.append(
            self._node.create_subscription(
                message_type,
                topic.name,
                self._callbacks.events,
                _event_qos(self._node, topic),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
                raw=True,
            )
        )


def _event_qos(node: Node, topic: EventTopic) -> QoSProfile:
    """Ask for what is offered: best effort, as drivers do, or reliable where all publishers are."""
    offered = {p.qos_profile.reliability for p in node.get_publishers_info_by_topic(topic.name)}
    reliable = offered == {ReliabilityPolicy.RELIABLE}
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=_EVENT_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
    )


def camera_info_topic(node: Node, topic: EventTopic) -> str:
    """Name the topic: `camera_info` if that is remapped, or the one beside the events."""
    name: str = node.resolve_topic_name("camera_info")
    if name != node.resolve_topic_name("camera_info", only_expand=True):
        return name
    return topic.camera_info
