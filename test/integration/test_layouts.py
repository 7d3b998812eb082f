"""The layouts of RViz and Foxglove, against the topics of the running node."""

import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from harness import ROOT, Peer, Processes

from emoflow_ros.node.topic_search import import_message_type

pytestmark = pytest.mark.dds

LAYOUTS = ROOT / "config" / "layouts"
RVIZ_TYPES = {
    "rviz_default_plugins/Image": "sensor_msgs/msg/Image",
    "rviz_default_plugins/Marker": "visualization_msgs/msg/Marker",
    "rviz_default_plugins/TwistStamped": "geometry_msgs/msg/TwistStamped",
}
IMAGE = "sensor_msgs/msg/Image"


@pytest.fixture
def published(peer: Peer, processes: Processes) -> dict[str, str]:
    """Types of what the node publishes, by topic."""
    processes.start_fake("Recorder")
    peer.connect()
    peer.spin_until(lambda: peer.node.count_publishers("/flow/tracks"), "the last topic")
    topics = peer.node.get_topic_names_and_types()
    return {name: types[0] for name, types in topics if peer.node.count_publishers(name)}


def rviz_topics() -> Iterator[tuple[str, str]]:
    layout = yaml.safe_load((LAYOUTS / "emoflow.rviz").read_text())
    for display in layout["Visualization Manager"]["Displays"]:
        yield display["Topic"]["Value"], RVIZ_TYPES[display["Class"]]


def foxglove_panels() -> dict[str, Any]:
    panels: dict[str, Any] = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"]
    return panels


def leaves(tree: Any) -> Iterator[str]:
    """Names of the panels that a Foxglove layout arranges."""
    if isinstance(tree, str):
        yield tree
    else:
        yield from leaves(tree["first"])
        yield from leaves(tree["second"])


def test_every_topic_of_the_layouts_is_published_with_its_type(published: dict[str, str]) -> None:
    for topic, kind in rviz_topics():
        assert published[topic] == kind
    for name, panel in foxglove_panels().items():
        match name.partition("!")[0]:
            case "Image":
                assert published[panel["imageMode"]["imageTopic"]] == IMAGE
            case "3D":
                assert [published[topic] for topic in panel["topics"]] == [
                    "visualization_msgs/msg/Marker"
                ]
            case "Plot":
                for path in panel["paths"]:
                    topic, *fields = path["value"].split(".")
                    message = import_message_type(published[topic])()
                    for field in fields:
                        message = getattr(message, field)
                    assert message == 0.0
            case "DiagnosticSummary":
                kind = "diagnostic_msgs/msg/DiagnosticArray"
                assert published[panel["topicToRender"]] == kind
            case "RawMessages":
                assert published[panel["topicPath"]] == "diagnostic_msgs/msg/DiagnosticStatus"
            case kind:
                pytest.fail(f"a panel of an unknown kind: {kind}")


def test_layouts_show_the_main_outputs() -> None:
    main = {"/egomotion/twist", "/flow/color", "/flow/iwe", "/flow/tracks"}
    assert {topic for topic, _ in rviz_topics()} == main
    text = (LAYOUTS / "foxglove.json").read_text()
    assert all(topic in text for topic in main)


def test_foxglove_layout_arranges_every_panel_once() -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())["layout"]
    arranged = list(leaves(layout))
    assert sorted(arranged) == sorted(foxglove_panels())
