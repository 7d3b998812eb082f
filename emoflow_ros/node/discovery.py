"""Which topic carries the events, and of which type: read from the graph, never guessed."""

import importlib
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from emoflow_ros.errors import InputError
from msg_adapters import supported_types

# Lidars publish these, too: only a topic that was asked for is taken for an event stream.
_AMBIGUOUS = "sensor_msgs/msg/PointCloud2"


@dataclass(frozen=True)
class EventTopic:
    """A topic and its message type, as in `dvs_msgs/msg/EventArray`."""

    name: str
    type: str

    @property
    def camera_info(self) -> str:
        """The camera_info topic beside it."""
        return f"{self.name.rpartition('/')[0]}/camera_info"


def find_event_topic(node: Node, wanted_type: str) -> EventTopic | None:
    """Find the topic to listen to.

    That is `events`, remapped or not, if somebody publishes it. If it is not remapped and
    nobody publishes it, the only event topic in the graph is taken.

    Args:
        node: whose graph and remapping count.
        wanted_type: the parameter `input.type`; empty for the type that is published.

    Returns:
        The topic, or None while there is none.

    Raises:
        InputError: a type that cannot be decoded, or several topics to choose from.
    """
    name = node.resolve_topic_name("events")
    if wanted_type:
        return EventTopic(name, _supported(name, wanted_type))
    graph = {topic: types[0] for topic, types in node.get_topic_names_and_types()}
    if name in graph and node.count_publishers(name):
        return EventTopic(name, _supported(name, graph[name]))
    if name != node.resolve_topic_name("events", only_expand=True):
        return None
    known = set(supported_types()) - {_AMBIGUOUS}
    found = [t for t in graph if graph[t] in known and node.count_publishers(t)]
    if len(found) > 1:
        raise InputError(
            "events",
            f"{len(found)} event topics: {', '.join(sorted(found))}",
            f"choose with --ros-args -r events:={min(found)}",
        )
    return EventTopic(found[0], graph[found[0]]) if found else None


def import_message_type(ros_type: str) -> Any:
    """Import the Python class of a message type.

    Raises:
        InputError: its package is not installed.
    """
    package, _, name = ros_type.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(
            ros_type,
            f"the message package {package} is not installed",
            f"install ros-jazzy-{package.replace('_', '-')} or build {package}, "
            "source its setup file and try again",
        ) from None


def _supported(name: str, ros_type: str) -> str:
    if ros_type not in supported_types():
        raise InputError(
            name,
            f"messages of type {ros_type} hold no events",
            f"give a topic of one of {', '.join(supported_types())}",
        )
    return ros_type
