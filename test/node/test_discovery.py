from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from emoflow_ros.errors import InputError
from emoflow_ros.node.discovery import EventTopic, find_event_topic, import_message_type

DVS = "dvs_msgs/msg/EventArray"
CLOUD = "sensor_msgs/msg/PointCloud2"


class Graph:
    """A node's view of the graph: topics with their type, and a remapping of `events`."""

    def __init__(self, topics: dict[str, str], events: str = "/events") -> None:
        self._topics = topics
        self._events = events

    def resolve_topic_name(self, name: str, *, only_expand: bool = False) -> str:
        return f"/{name}" if only_expand else self._events

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        return [(name, [ros_type]) for name, ros_type in self._topics.items()]

    def count_publishers(self, name: str) -> int:
        return int(name in self._topics)


def find(topics: dict[str, str], wanted_type: str = "", **kwargs: Any) -> EventTopic | None:
    return find_event_topic(Graph(topics, **kwargs), wanted_type)  # type: ignore[arg-type]


def test_nothing_is_found_in_an_empty_graph() -> None:
    assert find({}) is None
    assert find({"/imu": "sensor_msgs/msg/Imu"}) is None


def test_events_count_before_other_event_topics() -> None:
    assert find({"/cam/events": DVS, "/events": DVS}) == EventTopic("/events", DVS)


def test_only_event_topic_is_taken() -> None:
    found = find({"/cam/events": DVS, "/imu": "sensor_msgs/msg/Imu"})
    assert found == EventTopic("/cam/events", DVS)
    assert found.camera_info == "/cam/camera_info"


def test_point_cloud_is_taken_only_when_asked_for() -> None:
    assert find({"/lidar": CLOUD}) is None
    assert find({"/lidar": CLOUD}, events="/lidar") == EventTopic("/lidar", CLOUD)


def test_remapped_topic_is_waited_for() -> None:
    assert find({"/cam/events": DVS}, events="/other/events") is None


def test_given_type_needs_no_publisher() -> None:
    assert find({}, wanted_type=DVS) == EventTopic("/events", DVS)


@pytest.mark.parametrize(
    ("topics", "kwargs", "match"),
    [
        ({"/a": DVS, "/b": DVS}, {}, "2 event topics: /a, /b; choose with"),
        ({"/imu": "sensor_msgs/msg/Imu"}, {"events": "/imu"}, "hold no events"),
        ({}, {"wanted_type": "odd_msgs/msg/Odd"}, "hold no events"),
    ],
)
def test_what_cannot_be_decided_is_asked(
    topics: dict[str, str], kwargs: dict[str, str], match: str
) -> None:
    with pytest.raises(InputError, match=match):
        find(topics, **kwargs)


def test_type_that_is_not_installed_is_named() -> None:
    with pytest.raises(InputError, match="install ros-jazzy-odd-event-msgs or build"):
        import_message_type("odd_event_msgs/msg/Odd")


def test_installed_type_is_imported() -> None:
    from sensor_msgs.msg import PointCloud2

    assert import_message_type(CLOUD) is PointCloud2
