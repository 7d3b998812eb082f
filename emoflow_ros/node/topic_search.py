"""The names and types of the topics that the node listens to, found in the ROS graph."""

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from emoflow_ros.errors import InputError
from msg_adapters import supported_types

# The graph is discovered piece by piece. After this long without a change it counts as known.
SETTLING_S = 1.0

# Lidars publish this type, too. Such a topic is taken only if the user names it.
_AMBIGUOUS = "sensor_msgs/msg/PointCloud2"

# Message packages that have no Debian package for Jazzy.
_UNRELEASED = ("dv_ros2_msgs", "dvs_msgs", "event_array_msgs", "prophesee_event_msgs")
# Messages of ROS 1 that ROS 2 has under another name.
_ROS1_NAMES = {
    "rosgraph_msgs/msg/Log": "rcl_interfaces/msg/Log",
    "tf/msg/tfMessage": "tf2_msgs/msg/TFMessage",
}


@dataclass(frozen=True, order=True)
class EventTopic:
    """A topic and its message type, as in `dvs_msgs/msg/EventArray`."""

    name: str
    type: str

    def beside(self, name: str) -> str:
        """Name a topic in the same namespace."""
        return f"{self.name.rpartition('/')[0]}/{name}"


class TopicSearch:
    """Looks at the graph, again and again, for the topic to listen to.

    That is `events`, remapped or not, as soon as somebody publishes it. If it is not remapped and
    nobody publishes it, the only event topic in the graph is taken, once it has been the only one
    for SETTLING_S. A node in a namespace takes only topics of that namespace: others are those of
    other cameras.

    Args:
        node: whose graph and remapping count.
        wanted_type: the parameter `input.type`; empty for the type that is published.
        clock: monotonic time in s.
    """

    def __init__(
        self, node: Node, wanted_type: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._node = node
        self._wanted_type = wanted_type
        self._clock = clock
        self._found: frozenset[EventTopic] = frozenset()
        self._since = clock()

    @property
    def name(self) -> str:
        """Full name of `events`, as remapped."""
        return str(self._node.resolve_topic_name("events"))

    def look(self) -> EventTopic | None:
        """Look once.

        Returns:
            The topic, or None while there is none.

        Raises:
            InputError: a type that cannot be decoded, or several topics to choose from.
        """
        if self._wanted_type:
            return EventTopic(self.name, _supported(self.name, self._wanted_type))
        graph = self._published()
        if self.name in graph:
            return EventTopic(self.name, _supported(self.name, graph[self.name]))
        if self._is_remapped:
            return None
        found = self._inside(graph)
        if found != self._found:
            self._found, self._since = found, self._clock()
        if len(found) > 1:
            names = sorted(topic.name for topic in found)
            raise InputError(
                "events",
                f"{len(found)} event topics: {', '.join(names)}",
                f"choose with --ros-args -r events:={names[0]}",
            )
        if not found or self._clock() - self._since < SETTLING_S:
            return None
        return min(found)

    def others(self, taken: EventTopic) -> list[str]:
        """Name the other event topics that could be taken instead of this one."""
        return sorted(topic.name for topic in self._inside(self._published()) - {taken})

    def has_own(self) -> bool:
        """Tell whether somebody publishes `events`."""
        return self.name in self._published()

    def waiting(self) -> str:
        """After a look that found none, say what is waited for and which topics could be chosen."""
        if self._found:
            return (
                f"waiting for events: {min(self._found).name} is taken as soon as it has been the "
                f"only event topic for {SETTLING_S:.0f} s"
            )
        line = f"waiting for events: nobody publishes {self.name}"
        graph = self._published()
        outside = sorted(topic.name for topic in _event_topics(graph) - self._inside(graph))
        if self._is_remapped or not outside:
            return line
        return (
            f"{line}; outside the node's namespace: {', '.join(outside)}; "
            f"choose with --ros-args -r events:={outside[0]}"
        )

    @property
    def _is_remapped(self) -> bool:
        return self.name != self._node.resolve_topic_name("events", only_expand=True)

    def _inside(self, graph: dict[str, str]) -> frozenset[EventTopic]:
        """Event topics in the node's namespace."""
        namespace = self._node.get_namespace().rstrip("/") + "/"
        return frozenset(t for t in _event_topics(graph) if t.name.startswith(namespace))

    def _published(self) -> dict[str, str]:
        """Types by name, of `events` and of all topics of event types that somebody publishes."""
        return {
            name: types[0]
            for name, types in self._node.get_topic_names_and_types()
            if (name == self.name or types[0] in supported_types())
            and self._node.count_publishers(name)
        }


def topic_beside(node: Node, topic: EventTopic, name: str) -> str:
    """Name the topic of an input: `name` as remapped, or else the one beside the events."""
    resolved: str = node.resolve_topic_name(name)
    if resolved != node.resolve_topic_name(name, only_expand=True):
        return resolved
    return topic.beside(name)


def import_message_type(ros_type: str) -> Any:
    """Import the Python class of a message type.

    Raises:
        InputError: its package is not installed, or has no such message.
    """
    package, _, name = [*ros_type.split("/"), "", ""][:3]
    try:
        module = importlib.import_module(f"{package}.msg")
    except ImportError:
        wrong = f"the message package {package} is not installed"
        raise InputError(ros_type, wrong, _how_to_install(ros_type)) from None
    try:
        return getattr(module, name)
    except AttributeError:
        successor = _ROS1_NAMES.get(ros_type)
        raise InputError(
            ros_type,
            f"the message package {package} is installed, but has no message {name}",
            f"ROS 2 has {successor} instead" if successor else f"install the {package} that has it",
        ) from None


def _how_to_install(ros_type: str) -> str:
    package = ros_type.partition("/")[0]
    if successor := _ROS1_NAMES.get(ros_type):
        return f"it is of ROS 1 only; ROS 2 has {successor} instead"
    fix = f"build {package} in your workspace"
    if package not in _UNRELEASED:
        fix = f"install ros-jazzy-{package.replace('_', '-')}, if there is one, or {fix}"
    return f"{fix}, source its setup file and try again"


def _event_topics(graph: dict[str, str]) -> frozenset[EventTopic]:
    known = set(supported_types()) - {_AMBIGUOUS}
    return frozenset(EventTopic(name, graph[name]) for name in graph if graph[name] in known)


def _supported(name: str, ros_type: str) -> str:
    if ros_type not in supported_types():
        raise InputError(
            name,
            f"there is no decoder for messages of type {ros_type}",
            f"give a topic of one of {', '.join(supported_types())}",
        )
    return ros_type
