"""Tiny bags of dvs_msgs/EventArray, written with rosbags."""

import struct
from pathlib import Path

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from emoflow_ros.core.types.events import NS_PER_S, Events

EVENT_ARRAY = "dvs_msgs/msg/EventArray"
INFO = ("plumb_bob", (0.01, 0, 0, 0, 0.0), (20.0, 0, 16, 0, 20, 12, 0, 0, 1))
_DEFINITIONS = {
    "dvs_msgs/msg/Event": "uint16 x\nuint16 y\nbuiltin_interfaces/Time ts\nbool polarity\n",
    EVENT_ARRAY: "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n",
}


def make_events(n: int, width: int = 32, height: int = 24, start_s: float = 1.0) -> Events:
    """Events at 1 ms intervals that walk over the sensor."""
    k = np.arange(n)
    return Events(
        (k % width).astype(np.uint16),
        (k % height).astype(np.uint16),
        round(start_s * NS_PER_S) + k.astype(np.int64) * 1_000_000,
        k % 2 == 0,
    )


def assert_equal(read: Events, expected: Events) -> None:
    """Assert that two arrays of events hold the same, in the same types."""
    for name in ("x", "y", "t", "p"):
        got, want = getattr(read, name), getattr(expected, name)
        assert got.dtype == want.dtype
        np.testing.assert_array_equal(got, want, err_msg=name)


def typestore(ros1: bool):
    """Types of ROS 1 Noetic or ROS 2 Jazzy, and dvs_msgs."""
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    for name, text in _DEFINITIONS.items():
        types.register(get_types_from_msg(text, name))
    return types


def event_array_bytes(events: Events, width: int, height: int, ros1: bool) -> bytes:
    """Serialise with `struct`, field by field, as the formats are specified."""
    if ros1:
        head = struct.pack("<IIII", 0, 1, 2, 3) + b"cam"
        head += struct.pack("<III", height, width, len(events))
        rows = [
            struct.pack("<HHIIB", x, y, t // NS_PER_S, t % NS_PER_S, p)
            for x, y, t, p in zip(*_columns(events), strict=True)
        ]
        return head + b"".join(rows)
    body = struct.pack("<iII", 1, 2, 4) + b"cam\0"
    body += struct.pack("<III", height, width, len(events))
    for x, y, t, p in zip(*_columns(events), strict=True):
        body += b"\0" * (-len(body) % 2) + struct.pack("<HH", x, y)
        body += b"\0" * (-len(body) % 4)
        body += struct.pack("<iIB", t // NS_PER_S, t % NS_PER_S, p)
    return b"\0\x01\0\0" + body


def _columns(events: Events):
    return events.x.tolist(), events.y.tolist(), events.t.tolist(), events.p.tolist()


def write_event_bag(
    path: Path,
    batches: list[Events],
    *,
    topics: tuple[str, ...] = ("/cam/events",),
    size: tuple[int, int] = (32, 24),
    with_info: bool = True,
    storage: str = "ros1",
    log_times: list[int] | None = None,
    infos: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...] = (INFO,),
) -> Path:
    """Write a bag: `storage` is ros1, sqlite3 or mcap, `log_times` are in ns.

    `infos` are the model, D and K of each camera_info.
    """
    ros1 = storage == "ros1"
    types = typestore(ros1)
    if ros1:
        writer = rosbag1.Writer(path)
    else:
        plugin = rosbag2.StoragePlugin[storage.upper()]
        writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with writer:
        for topic in topics:
            connection = writer.add_connection(topic, EVENT_ARRAY, typestore=types)
            for i, events in enumerate(batches):
                data = event_array_bytes(events, *size, ros1)
                writer.write(connection, log_times[i] if log_times else NS_PER_S + i, data)
        if with_info:
            _write_infos(writer, types, topics[0] if topics else "/cam/events", size, ros1, infos)
    return path


def _write_infos(writer, types, topic, size, ros1, infos):
    name = "sensor_msgs/msg/CameraInfo"
    info, roi = types.types[name], types.types["sensor_msgs/msg/RegionOfInterest"]
    header, time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    stamp = time(1, 0)
    connection = writer.add_connection(
        topic.rpartition("/")[0] + "/camera_info", name, typestore=types
    )
    for i, (model, d, k) in enumerate(infos):
        message = info(
            header(0, stamp, "cam") if ros1 else header(stamp, "cam"),
            size[1],
            size[0],
            model,
            np.array(d, float),
            np.array(k, float),
            np.eye(3).ravel(),
            np.zeros(12),
            0,
            0,
            roi(0, 0, 0, 0, False),
        )
        data = types.serialize_ros1(message, name) if ros1 else types.serialize_cdr(message, name)
        writer.write(connection, NS_PER_S + i, data)
