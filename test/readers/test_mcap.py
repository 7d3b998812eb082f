"""MCAP files with any profile, with any index or none: all their messages, in order of log time."""

import itertools
from pathlib import Path

import pytest
from event_bags import EVENT_ARRAY, assert_equal, event_array_bytes, make_events
from mcap_files import McapLayout, Topic, write_mcap

from emoflow_ros.commands.info import inspect
from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.bag_files import open_bag, read_messages

CDR = Topic("/cam/events", (EVENT_ARRAY, "ros2msg", ""), "cdr")
ROS1 = Topic("/cam/events", ("dvs_msgs/EventArray", "ros1msg", ""), "ros1")
OTHER = Topic("/clock", ("rosgraph_msgs/msg/Clock", "ros2msg", ""), "cdr")
BATCHES = [make_events(20, start_s=1 + i) for i in range(13)]
TIME = 10**9


def event_messages(topic: int = 0, *, ros1: bool = False) -> list[tuple[int, int, bytes]]:
    return [
        (topic, TIME * (i + 1), event_array_bytes(events, 32, 24, ros1))
        for i, events in enumerate(BATCHES)
    ]


def read(path: Path) -> Events:
    with open_recording(path) as recording:
        return Events.concatenate(list(recording.event_chunks()))


@pytest.mark.parametrize("layout", list(itertools.product([0, 5], *[[True, False]] * 4)))
def test_every_combination_of_indexes(tmp_path, layout, capsys):
    clock = [(1, TIME * i + 5, b"\0\1\0\0" + bytes(8)) for i in range(1, 20)]
    messages = sorted(event_messages() + clock, key=lambda m: m[1])
    chunk, *rest = layout
    path = write_mcap(tmp_path / "a.mcap", [CDR, OTHER], messages, McapLayout("ros2", chunk, *rest))
    assert_equal(read(path), Events.concatenate(BATCHES))
    with open_bag(path) as bag:
        assert [(c.topic, c.msgcount) for c in bag.connections] == [
            ("/cam/events", 13),
            ("/clock", 19),
        ]
        assert (bag.start_time, bag.end_time) == (TIME, 19 * TIME + 6)
        both = [(c.topic, t) for c, t, _ in read_messages(path, bag, bag.connections)]
        assert both == [((CDR, OTHER)[i].name, t) for i, t, _ in messages]
        late = [t for _, t, _ in read_messages(path, bag, bag.connections, 9 * TIME)]
        assert late == [t for _, t, _ in messages if t >= 9 * TIME]
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("chunk", [0, 3])
def test_messages_out_of_order_are_sorted(tmp_path, chunk, index):
    messages = event_messages()
    messages[4:9] = reversed(messages[4:9])  # over the border of two chunks
    layout = McapLayout(chunk=chunk, chunk_index=index, statistics=index)
    assert_equal(
        read(write_mcap(tmp_path / "a.mcap", [CDR], messages, layout)), Events.concatenate(BATCHES)
    )


@pytest.mark.parametrize("profile", ["ros1", "ros2", "", "x" * 40])
def test_schema_decides_channel_by_channel(tmp_path, profile):
    """Two cameras, one converted from ROS 1, beside a channel of another world."""
    left, right = CDR._replace(name="/left/events"), ROS1._replace(name="/right/events")
    web = Topic("/web", ("foxglove.Grid", "protobuf", ""), "protobuf")
    plain = Topic("/plain", None, "json")
    messages = (
        event_messages(0) + event_messages(1, ros1=True) + [(2, TIME, b"x"), (3, TIME, b"{}")]
    )
    path = write_mcap(
        tmp_path / "a.mcap", [left, right, web, plain], messages, McapLayout(profile=profile)
    )
    for topic in ("/left/events", "/right/events"):
        with open_recording(path, topic=topic) as recording:
            assert_equal(
                Events.concatenate(list(recording.event_chunks())), Events.concatenate(BATCHES)
            )
    info = inspect(path)
    assert [(t.name, t.type, t.events) for t in info.topics] == [
        ("/left/events", EVENT_ARRAY, 260),
        ("/right/events", EVENT_ARRAY, 260),
    ]
    assert info.other_topics == [
        {"name": "/plain", "type": "no type, json", "messages": 1},
        {"name": "/web", "type": "foxglove.Grid", "messages": 1},
    ]


def test_one_topic_of_both_worlds(tmp_path):
    messages = event_messages(0)[:6] + event_messages(1, ros1=True)[6:]
    path = write_mcap(tmp_path / "a.mcap", [CDR, ROS1], messages)
    assert_equal(read(path), Events.concatenate(BATCHES))
    [topic] = inspect(path).topics
    assert (topic.events, topic.packets, topic.malformed) == (260, 13, 0)


def test_event_type_in_another_encoding_is_no_event_topic(tmp_path):
    topic = CDR._replace(schema=(EVENT_ARRAY, "jsonschema", "{}"), encoding="json")
    path = write_mcap(tmp_path / "a.mcap", [topic], [(0, TIME, b"{}")])
    with pytest.raises(
        InputError, match=r"no topic of a known event type; it holds /cam/events \(dvs_msgs"
    ):
        read(path)


def test_messages_that_are_announced_and_not_there(tmp_path):
    """The statistics count messages of a channel that no chunk holds."""
    clock = [(1, TIME * i, b"\0\1\0\0" + bytes(8)) for i in range(1, 14)]
    path = write_mcap(tmp_path / "a.mcap", [CDR, OTHER], clock, McapLayout(message_index=False))
    data = path.read_bytes()  # all 13 are announced of the events
    at = data.rindex(b"\x02\0" + (13).to_bytes(8, "little"))
    path.write_bytes(data[:at] + b"\x01" + data[at + 1 :])
    said = "damaged bag .it says that it holds 13 messages on /cam/events, and none is there"
    with open_bag(path) as bag, pytest.raises(InputError, match=said):
        list(read_messages(path, bag, bag.connections))
    with pytest.raises(InputError, match=said):
        read(path)
    with pytest.raises(InputError, match=said):
        inspect(path)


@pytest.mark.parametrize("name", ["a_chunk_index_only", "b_ros1_profile", "h_empty_profile"])
def test_files_of_the_field(shared_data, name, capsys):
    field = shared_data / "field"
    info, control = inspect(field / f"{name}.mcap"), inspect(field / "control.mcap")
    assert (info.topics, info.other_topics) == (control.topics, control.other_topics)
    assert (info.topics[0].packets, info.topics[0].events, info.missing) == (100, 18109, [])
    assert info.other_topics[0]["messages"] == 100
    with (
        open_recording(field / f"{name}.mcap") as one,
        open_recording(field / "control.mcap") as two,
    ):
        assert one.camera == two.camera
        assert_equal(*(Events.concatenate(list(r.event_chunks())) for r in (one, two)))
    assert capsys.readouterr().err == ""
