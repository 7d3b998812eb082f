"""The speed of the camera: the scale of its direction, from a parameter or a topic."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import Vector3
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.twist import SpeedLog
from emoflow_ros.errors import InputError
from emoflow_ros.node.ros_arguments import refused_values
from emoflow_ros.node.settings import ScaleOptions
from emoflow_ros.node.topic_search import import_message_type
from emoflow_ros.node.twist_output import to_ns

# Reads the velocity from each type of message: a vector or a number, in m/s.
SPEED_TYPES: dict[str, Callable[[Any], Vector3 | float]] = {
    "nav_msgs/msg/Odometry": lambda message: message.twist.twist.linear,
    "geometry_msgs/msg/TwistStamped": lambda message: message.twist.linear,
    "std_msgs/msg/Float64": lambda message: message.data,
}

_SPEED_QOS = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
_LOOK_S = 0.2


@dataclass(frozen=True)
class Scaling:
    """The scale of one window.

    Attributes:
        speed: what the unit direction is multiplied by, m/s; None if it stays one.
        source: where it comes from, as `scale.source` names it.
        problem: why it is not what was asked for; empty if it is.
    """

    speed: float | None = None
    source: str = "none"
    problem: str = ""


class Scale:
    """The scale at the time of a window, from nowhere, a parameter or a topic.

    Args:
        node: listens to the topic, if there is one.
        options: where the scale comes from.
    """

    def __init__(self, node: Node, options: ScaleOptions) -> None:
        self._node = node
        self._options = options
        self._input: SpeedInput | None = None
        self.set_options(options)

    def set_options(self, options: ScaleOptions) -> None:
        """Take the scale from where these options say from now on."""
        topic = options.topic if options.source == "topic" else None
        if self._input is not None and self._input.topic != topic:
            self.close()
        if self._input is None and topic is not None:
            self._input = SpeedInput(self._node, topic)
        self._options = options

    def at(self, stamp: int) -> Scaling:
        """Return the scale at this ROS time (ns): none where the topic's speed is too old."""
        options = self._options
        if options.source == "parameter":
            return Scaling(options.speed, "parameter")
        if self._input is None:
            return Scaling()
        speed = self._input.log.at(stamp, round(options.max_age_s * NS_PER_S))
        if speed is None:
            reason = self._input.problem or (
                f"no speed on {self._input.topic} within {options.max_age_s:g} s of the window"
            )
            return Scaling(problem=f"{reason}; linear is a unit direction")
        return Scaling(speed, "topic")

    def close(self) -> None:
        """Stop listening."""
        if self._input is not None:
            self._input.close()
            self._input = None


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
        take = partial(self._take, ros_type=types[0])
        overrides = QoSOverridingOptions.with_default_policies()
        with refused_values():  # of qos_overrides; they cannot change, so this ends the node
            self._subscription = self._node.create_subscription(
                message_type, name, take, _SPEED_QOS, qos_overriding_options=overrides
            )

    def _take(self, message: Any, ros_type: str) -> None:
        stamp, speed = to_speed(message, ros_type)
        if stamp is None:
            stamp = self._node.get_clock().now().nanoseconds
        if math.isfinite(speed):
            self.log.add(stamp, speed)


def to_speed(message: Any, ros_type: str) -> tuple[int | None, float]:
    """Read the time of a message, ROS time in ns or None without a stamp, and its speed in m/s.

    Args:
        message: of one of SPEED_TYPES.
        ros_type: which one.
    """
    velocity = SPEED_TYPES[ros_type](message)
    if isinstance(velocity, float):
        return None, abs(velocity)
    speed = math.hypot(velocity.x, velocity.y, velocity.z)
    return to_ns(message.header.stamp) or None, speed
