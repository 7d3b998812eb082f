"""The subscription to the camera's speed, whatever type of message carries it."""

import math
from functools import partial
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from emoflow_ros.core.speed import SpeedLog
from emoflow_ros.errors import InputError
from emoflow_ros.node.converters import SPEED_TYPES, to_speed
from emoflow_ros.node.topic_search import import_message_type

_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_LOOK_S = 0.2


class SpeedInput:
    """Looks for a topic until somebody publishes it, then keeps the speeds that it carries.

    A message without a stamp counts from its arrival. Speeds that are not finite are left out.

    Args:
        node: to subscribe with.
        topic: its name.

    Attributes:
        topic: its name, as given.
        log: the speeds by ROS time.
        problem: why there is no subscription yet; empty if there is one.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self.topic = topic
        self.log = SpeedLog()
        self.problem = ""
        self._node = node
        self._subscription: Subscription | None = None
        self._timer = node.create_timer(
            _LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._look()

    def close(self) -> None:
        """Unsubscribe, or look no longer."""
        self._node.destroy_timer(self._timer)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)

    def _look(self) -> None:
        name = self._node.resolve_topic_name(self.topic)
        types = [p.topic_type for p in self._node.get_publishers_info_by_topic(name)]
        if not types:
            self.problem = f"nobody publishes {name}"
            return
        if types[0] not in SPEED_TYPES:
            known = ", ".join(SPEED_TYPES)
            self.problem = f"{name}: {types[0]} holds no speed, give a topic of one of {known}"
            return
        try:
            message_type = import_message_type(types[0])
        except InputError as error:
            self.problem = str(error)
            return
        self.problem = ""
        self._node.destroy_timer(self._timer)
        self._subscription = self._node.create_subscription(
            message_type,
            name,
            partial(self._take, ros_type=types[0]),
            _QOS,
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _take(self, message: Any, ros_type: str) -> None:
        stamp, speed = to_speed(message, ros_type)
        if stamp is None:
            stamp = self._node.get_clock().now().nanoseconds
        if math.isfinite(speed):
            self.log.add(stamp, speed)
