"""Arrays of events of all drivers, and by the definition that a bag of an old one carries."""

import struct
from pathlib import Path

import numpy as np
import pytest
from event_bags import assert_equal, event_array_bytes, make_events
from rosbags import rosbag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from emoflow_ros.commands.info import inspect, main
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.bag_files import open_bag, read_messages
from emoflow_ros.readers.ros1_conversion import Ros1Converter
from msg_adapters import make_decoder

EVENTS = make_events(30)
NAME = "dvs_msgs/msg/EventArray"
ARRAY = "dvs_msgs/Event[] events\n"
HEADER = "std_msgs/Header header\n"
HEAD = struct.pack("<IIII", 0, 5, 6, 3) + b"cam"


def write(path: Path, name: str, array: str, event: str, data: bytes) -> Path:
    """Write a ROS 1 bag of one message with its definition."""
    store = get_typestore(Stores.ROS1_NOETIC)
    package = name.partition("/")[0]
    types = get_types_from_msg(event, f"{package}/msg/Event") | get_types_from_msg(array, name)
    store.register(types)
    with rosbag1.Writer(path) as writer:
        connection = writer.add_connection("/dvs/events", name, typestore=store)
        writer.write(connection, NS_PER_S, data)
    return path


def rows(code: str, *columns: np.ndarray) -> bytes:
    packed = (
        struct.pack(f"<{code}", *row) for row in zip(*map(np.ndarray.tolist, columns), strict=True)
    )
    return struct.pack("<I", len(EVENTS)) + b"".join(packed)


def read(path: Path) -> Events:
    with open_recording(path) as recording:
        return Events.concatenate(list(recording.event_chunks()))


S, NS, US = EVENTS.t // NS_PER_S, EVENTS.t % NS_PER_S, EVENTS.t // 1000
X, Y, P = EVENTS.x, EVENTS.y, EVENTS.p
OLDER = {
    "other order, integer microseconds": (
        HEADER + "uint16 width\nuint16 height\n" + ARRAY,
        "uint64 time\nuint16 x\nuint16 y\nbool polarity\n",
        HEAD + struct.pack("<HH", 32, 24) + rows("QHH?", US, X, Y, P),
    ),
    "no header and no size": (
        ARRAY,
        "uint16 x\nuint16 y\ntime time\nbool polarity\n",
        rows("HHII?", X, Y, S, NS, P),
    ),
    "polarity of two signs, larger coordinates": (
        HEADER + "string camera\n" + ARRAY + "uint32 height\nuint32 width\n",
        "int32 x\nint32 y\nint8 polarity\ntime ts\nfloat32 extra\n",
        HEAD
        + struct.pack("<I", 3)
        + b"dvs"
        + rows("iibIIf", X, Y, np.where(P, 1, -1), S, NS, S)
        + struct.pack("<II", 24, 32),
    ),
    "seconds": (
        HEADER + ARRAY,
        "uint8 x\nuint8 y\nfloat64 t\nuint8 p\n",
        HEAD + rows("BBdB", X, Y, EVENTS.t / 1e9, P),
    ),
    "nanoseconds since 1970": (
        HEADER + ARRAY,
        "uint16 x\nuint16 y\nint64 timestamp\nuint8 pol\n",
        HEAD + rows("HHqB", X, Y, EVENTS.t + 1_400_000_000 * NS_PER_S, P),
    ),
}


@pytest.mark.parametrize("name", OLDER)
def test_older_definitions_are_decoded_as_the_bag_says(tmp_path, name):
    path = write(tmp_path / "a.bag", NAME, *OLDER[name])
    shift = 1_400_000_000 * NS_PER_S if "1970" in name else 0
    assert_equal(read(path), Events(X, Y, EVENTS.t + shift, P))
    [topic] = inspect(path).topics
    assert (topic.events, topic.malformed) == (30, 0)
    assert (topic.width, topic.height) == ((32, 24) if "width" in OLDER[name][0] else (0, 0))


@pytest.mark.parametrize("name", OLDER)
def test_older_definitions_become_messages_of_today_where_they_are_published(tmp_path, name):
    path = write(tmp_path / "a.bag", NAME, *OLDER[name])
    with open_bag(path) as bag:
        [(connection, _, data)] = read_messages(path, bag, bag.connections)
        cdr = Ros1Converter(bag.connections).to_cdr(data, connection.msgtype)
    message = make_decoder(NAME, "cdr").decode(cdr)
    shift = 1_400_000_000 * NS_PER_S if "1970" in name else 0
    assert_equal(message.events, Events(X, Y, EVENTS.t + shift, P))
    has_header = OLDER[name][0].startswith(HEADER)
    stamp = 5 * NS_PER_S + 6 if has_header else int(EVENTS.t[0])
    assert (message.stamp, message.frame_id) == (stamp, "cam" if has_header else "")


@pytest.mark.parametrize(
    ("array", "event", "why"),
    [
        (HEADER + ARRAY, "uint16 x\nuint16 y\nbool polarity\n", "its definition has no time"),
        (HEADER + ARRAY, "uint16 x\ntime ts\n", "its definition has no y and no polarity"),
        (HEADER + "uint32 n\n", "uint16 x\n", "its definition has no x and no y and no time"),
        (HEADER + ARRAY, "string x\nuint16 y\ntime ts\nbool p\n", "the member 'x' of its events"),
        (HEADER + "uint8[4] z\n" + ARRAY, "uint16 x\n", "members of unknown kinds"),
    ],
)
def test_definitions_that_are_not_understood_are_refused_by_name(
    tmp_path, monkeypatch, array, event, why
):
    path = write(tmp_path / "a.bag", NAME, array, event, HEAD)
    with open_recording(path) as recording, pytest.raises(InputError) as caught:
        list(recording.event_chunks())
    assert str(caught.value).startswith(f"/dvs/events: {NAME} cannot be decoded: ")
    assert why in str(caught.value)
    info = inspect(path)
    assert info.topics == []
    assert any(why in missing for missing in info.missing)
    monkeypatch.setattr("sys.argv", ["info", str(path)])
    assert main() == 2


def test_cut_messages_of_an_older_definition_are_damage(tmp_path):
    array, event, data = OLDER["seconds"]
    path = write(tmp_path / "a.bag", NAME, array, event, data[:-1])
    with pytest.raises(InputError, match=r"damaged message on /dvs/events \(30 events announced"):
        read(path)


@pytest.mark.parametrize("package", ["dv_ros_msgs", "prophesee_event_msgs", "dvs_msgs"])
def test_bags_of_all_drivers(tmp_path, package):
    array = HEADER + f"uint32 height\nuint32 width\n{package}/Event[] events\n"
    event = "uint16 x\nuint16 y\ntime ts\nbool polarity\n"
    data = event_array_bytes(EVENTS, 32, 24, True)
    path = write(tmp_path / "a.bag", f"{package}/msg/EventArray", array, event, data)
    assert_equal(read(path), EVENTS)


def test_unknown_type_is_named_and_not_said_to_be_empty(tmp_path):
    array, event, data = OLDER["seconds"]
    name = "new_driver_msgs/msg/EventArray"
    array = array.replace("dvs_msgs", "new_driver_msgs")
    path = write(tmp_path / "a.bag", name, array, event, data)
    with pytest.raises(InputError) as caught:
        read(path)
    assert f"no topic of a known event type; it holds /dvs/events ({name}); " in str(caught.value)
    assert "dv_ros2_msgs/msg/EventArray, dv_ros_msgs/msg/EventArray, dvs_msgs" in str(caught.value)
    assert "no events" not in str(caught.value)
    assert inspect(path).missing == ["no topic of a known event type"]
