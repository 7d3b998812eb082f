import sys
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from graph import CLOUD, DVS, Graph

from emoflow_ros.errors import InputError
from emoflow_ros.node.topic_search import (
    SETTLING_S,
    EventTopic,
    TopicSearch,
    import_message_type,
)


def search(graph: Graph, wanted_type: str = "") -> TopicSearch:
    return TopicSearch(graph, wanted_type, graph.clock)  # type: ignore[arg-type]


def find(topics: dict[str, str], wanted_type: str = "", **kwargs: Any) -> EventTopic | None:
    """Look twice, a settling time apart."""
    graph = Graph(topics, **kwargs)
    looking = search(graph, wanted_type)
    looking.look()
    graph.now += SETTLING_S
    return looking.look()


def test_nothing_is_found_in_an_empty_graph() -> None:
    assert find({}) is None
    assert find({"/imu": "sensor_msgs/msg/Imu"}) is None


def test_events_count_before_other_event_topics_and_at_once() -> None:
    graph = Graph({"/cam/events": DVS, "/events": DVS})
    assert search(graph).look() == EventTopic("/events", DVS)


def test_only_event_topic_is_taken() -> None:
    found = find({"/cam/events": DVS, "/imu": "sensor_msgs/msg/Imu"})
    assert found == EventTopic("/cam/events", DVS)
    assert found.beside("camera_info") == "/cam/camera_info"


def test_only_event_topic_is_taken_when_the_graph_has_settled() -> None:
    graph = Graph({"/cam/events": DVS})
    looking = search(graph)
    assert looking.look() is None
    graph.now = 0.99 * SETTLING_S
    assert looking.look() is None
    graph.now = SETTLING_S
    assert looking.look() == EventTopic("/cam/events", DVS)


def test_every_change_of_the_candidates_starts_the_settling_anew() -> None:
    graph = Graph({})
    looking = search(graph)
    graph.now = 5.0
    graph.topics["/cam/events"] = DVS
    assert looking.look() is None
    graph.now = 5.9
    graph.topics["/other/events"] = DVS
    with pytest.raises(InputError, match="2 event topics"):
        looking.look()
    graph.now = 6.5
    del graph.topics["/cam/events"]
    assert looking.look() is None
    graph.now = 7.4
    assert looking.look() is None
    graph.now = 7.5
    assert looking.look() == EventTopic("/other/events", DVS)


def test_topics_of_other_types_do_not_disturb_the_settling() -> None:
    graph = Graph({"/cam/events": DVS})
    looking = search(graph)
    looking.look()
    graph.now = SETTLING_S
    graph.topics |= {"/imu": "sensor_msgs/msg/Imu", "/lidar": CLOUD}
    assert looking.look() == EventTopic("/cam/events", DVS)


def test_only_topics_of_the_own_namespace_are_taken_unasked() -> None:
    assert find({"/left/events": DVS, "/rightmost/events": DVS}, namespace="/right") is None
    found = find({"/left/events": DVS, "/right/davis/events": DVS}, namespace="/right")
    assert found == EventTopic("/right/davis/events", DVS)
    remapped = find({"/left/events": DVS}, namespace="/right", events="/left/events")
    assert remapped == EventTopic("/left/events", DVS)


def test_topics_of_other_namespaces_are_none_besides_the_one_taken() -> None:
    graph = Graph({"/left/events": DVS, "/right/a": DVS, "/right/b": DVS}, namespace="/right")
    assert search(graph).others(EventTopic("/right/a", DVS)) == ["/right/b"]


def test_waiting_names_other_topics_only_where_they_could_be_chosen() -> None:
    assert search(Graph({})).waiting() == "waiting for events: nobody publishes /events"
    asked = Graph({"/left/events": DVS}, namespace="/right", events="/mine")
    assert search(asked).waiting() == "waiting for events: nobody publishes /mine"


def test_waiting_names_the_topic_that_is_about_to_be_taken() -> None:
    looking = search(Graph({"/cam/events": DVS}))
    assert looking.look() is None
    assert looking.waiting() == (
        "waiting for events: /cam/events is taken as soon as it has been the only event topic "
        "for 1 s"
    )


def test_point_cloud_is_taken_only_when_asked_for() -> None:
    assert find({"/lidar": CLOUD}) is None
    assert find({"/lidar": CLOUD}, events="/lidar") == EventTopic("/lidar", CLOUD)


def test_remapped_topic_is_waited_for_and_taken_at_once() -> None:
    graph = Graph({"/cam/events": DVS}, events="/other/events")
    looking = search(graph)
    assert looking.look() is None
    graph.now = 10 * SETTLING_S
    assert looking.look() is None
    graph.topics["/other/events"] = DVS
    assert looking.look() == EventTopic("/other/events", DVS)


def test_given_type_needs_no_publisher() -> None:
    assert search(Graph({}), wanted_type=DVS).look() == EventTopic("/events", DVS)


def test_others_are_the_event_topics_besides_the_one_taken() -> None:
    graph = Graph({"/c": DVS, "/b": DVS, "/a": DVS, "/lidar": CLOUD})
    assert search(graph).others(EventTopic("/b", DVS)) == ["/a", "/c"]


@pytest.mark.parametrize(
    ("topics", "kwargs", "match"),
    [
        ({"/a": DVS, "/b": DVS}, {}, "2 event topics: /a, /b; choose with .* events:=/a"),
        (
            {"/imu": "sensor_msgs/msg/Imu"},
            {"events": "/imu"},
            "there is no decoder for messages of type",
        ),
        ({}, {"wanted_type": "odd_msgs/msg/Odd"}, "there is no decoder for messages of type"),
    ],
)
def test_what_cannot_be_decided_is_asked(
    topics: dict[str, str], kwargs: dict[str, str], match: str
) -> None:
    with pytest.raises(InputError, match=match):
        find(topics, **kwargs)


@pytest.mark.parametrize(
    ("package", "fix"),
    [
        ("dvs_msgs", "build dvs_msgs in your workspace, source"),
        ("odd_msgs", "install ros-jazzy-odd-msgs, if there is one, or build odd_msgs in your"),
    ],
)
def test_type_that_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, package: str, fix: str
) -> None:
    monkeypatch.setitem(sys.modules, f"{package}.msg", None)
    with pytest.raises(InputError, match=f"the message package {package} is not .*; {fix}"):
        import_message_type(f"{package}/msg/Odd")


@pytest.mark.parametrize(
    ("ros_type", "line"),
    [
        (
            "rosgraph_msgs/msg/Log",
            "the message package rosgraph_msgs is installed, but has no message Log; ROS 2 has "
            "rcl_interfaces/msg/Log instead",
        ),
        (
            "tf/msg/tfMessage",
            "the message package tf is not installed; it is of ROS 1 only; ROS 2 has "
            "tf2_msgs/msg/TFMessage instead",
        ),
        (
            "sensor_msgs/msg/Odd",
            "the message package sensor_msgs is installed, but has no message Odd; install the "
            "sensor_msgs that has it",
        ),
    ],
)
def test_types_that_ros2_has_under_another_name(ros_type: str, line: str) -> None:
    with pytest.raises(InputError) as error:
        import_message_type(ros_type)
    assert str(error.value) == f"{ros_type}: {line}"


def test_installed_type_is_imported() -> None:
    from sensor_msgs.msg import PointCloud2

    assert import_message_type(CLOUD) is PointCloud2
