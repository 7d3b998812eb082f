"""What a replay publishes of bags that recorders, converters and people have left as they are."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from event_bags import event_array_bytes, make_events, write_event_bag
from mcap_files import McapLayout, Topic, write_mcap

from emoflow_ros.commands import replay
from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_files import open_bag
from msg_adapters import make_decoder

type Published = list[tuple[str, bytes]]


class Node:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.published: Published = []

    def create_publisher(self, kind: object, topic: str, qos: object) -> "Publisher":
        return Publisher(self.published, topic)


class Publisher:
    def __init__(self, published: Published, topic: str) -> None:
        self._published, self._topic = published, topic

    def publish(self, data: bytes) -> None:
        self._published.append((self._topic, data))

    def wait_for_all_acked(self, timeout: object) -> None:
        pass


@pytest.fixture(autouse=True)
def _all_types_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "import_message_type", lambda name: name)


def published(path: Path) -> Published:
    node = Node()
    with open_bag(path) as bag:
        player = replay.Player(node, path, bag, topics=None, with_clock=False)
        player.play(rate=1000)
    assert player.published == len(node.published)
    return node.published


@pytest.mark.parametrize("name", ["a_chunk_index_only", "b_ros1_profile", "h_empty_profile"])
def test_field_recordings_are_published_as_the_whole_one(shared_data: Path, name: str) -> None:
    """The same bytes: messages of ROS 1 are converted."""
    expected = published(shared_data / "field" / "control.mcap")
    found = published(shared_data / "field" / f"{name}.mcap")
    assert len(found) == 200
    assert sorted(data for _, data in found) == sorted(data for _, data in expected)


def test_compressed_messages_are_published_unpacked(shared_data: Path) -> None:
    found = published(shared_data / "field" / "msg_zstd_no_metadata")
    decoder = make_decoder("dvs_msgs/msg/EventArray", "cdr")
    events = [decoder.decode(data).events for topic, data in found if topic == "/dvs/events"]
    assert (len(found), len(events), sum(map(len, events))) == (200, 100, 18109)


def test_one_topic_of_ros1_and_ros2(tmp_path: Path) -> None:
    events = make_events(30)
    text = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
    text += "=" * 80 + "\nMSG: dvs_msgs/Event\nuint16 x\nuint16 y\ntime ts\nbool polarity\n"
    topics = [
        Topic("/events", ("dvs_msgs/msg/EventArray", "ros2msg", ""), "cdr"),
        Topic("/events", ("dvs_msgs/EventArray", "ros1msg", text), "ros1"),
    ]
    messages = [(i, 10**9 + i, event_array_bytes(events, 32, 24, bool(i))) for i in (0, 1)]
    (_, first), (_, second) = published(
        write_mcap(tmp_path / "a.mcap", topics, messages, McapLayout(profile=""))
    )
    assert first == second == messages[0][2]


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_topics_without_messages_are_an_error(tmp_path: Path, storage: str) -> None:
    path = tmp_path / ("a.bag" if storage == "ros1" else "a")
    write_event_bag(path, [], with_info=False, storage=storage)
    with pytest.raises(InputError, match=r"no (messages|messages on /cam/events); "):
        published(path)


def test_messages_of_another_world_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    topics = [Topic("/web", ("foxglove.Grid", "protobuf", ""), "protobuf")]
    path = write_mcap(tmp_path / "a.mcap", topics, [(0, 10**9, b"x")])
    with pytest.raises(InputError, match="no topic can be published"):
        published(path)
    said = "left out: /web: foxglove.Grid: its messages are protobuf, not of ROS; convert them"
    assert capsys.readouterr().err == said + "\n"
