"""Recordings of the drivers of 2021 to 2023, in bags of all kinds, also split and compressed."""

import sys
from collections.abc import Sequence
from pathlib import Path
from shutil import move
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from emoflow_ros.core.types.events import Events
from emoflow_ros.readers import open_recording

sys.path.append(str(Path(__file__).parents[1] / "msg_adapters"))
from encoders import ENCODERS, payload

KIND = "event_array_msgs/msg/EventArray"
LAYOUT = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
    "string encoding\nbool is_bigendian\nuint8[] events\n"
)
TOPIC = "/my_camera/raw_events"  # not the `events` that the node asks for
S = 10**9


def messages(store: Any, ros1: bool, parts: Sequence[Events]) -> list[tuple[str, str, bytes, int]]:
    """Topic, type, data and log time in ns; evt3 carries its state from packet to packet."""
    types = store.types
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    head = header(stamp=time(1, 0), frame_id="cam", **({"seq": 0} if ros1 else {}))
    write = store.serialize_ros1 if ros1 else store.serialize_cdr
    stream = ENCODERS["evt3"](Events.concatenate(list(parts)))
    rows = []
    for seq, data in enumerate(np.array_split(stream, len(parts))):
        packet = types[KIND](
            head, 24, 32, seq, 0, "evt3", False, np.frombuffer(payload(data), "u1")
        )
        rows.append((TOPIC, KIND, bytes(write(packet, KIND)), (1 + seq) * S))
    name = "sensor_msgs/msg/CameraInfo"
    k = np.array([20.0, 0, 16, 0, 20, 12, 0, 0, 1])
    letters = "DKRP" if ros1 else "dkrp"
    matrices = dict(zip(letters, (np.zeros(5), k, np.eye(3).ravel(), np.zeros(12)), strict=True))
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = types[name](
        header=head, height=24, width=32, distortion_model="plumb_bob", binning_x=0, binning_y=0,
        roi=roi, **matrices,
    )  # fmt: skip
    return [*rows, ("/my_camera/camera_info", name, bytes(write(info, name)), S)]


def write_bag(writer: Any, rows: Sequence[tuple[str, str, bytes, int]], store: Any) -> None:
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in {row[0]: row[1] for row in rows}.items()
        }
        for topic, _, data, logged in rows:
            writer.write(connections[topic], logged, data)


def make_bag(folder: Path, kind: str, parts: Sequence[Events]) -> Path:
    ros1 = kind.startswith("ros1")
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(LAYOUT, KIND))
    rows = messages(store, ros1, parts)
    storage, _, how = kind.partition("-")
    if ros1:
        writer = rosbag1.Writer(folder / "a.bag")
        if how:
            writer.set_compression(rosbag1.Writer.CompressionFormat[how.upper()])
        write_bag(writer, rows, store)
        return folder / "a.bag"
    plugin = rosbag2.StoragePlugin[storage.upper()]
    if how == "split":
        halves = (rows[:2], rows[2:])
        for name, half in zip(("a", "b"), halves, strict=True):
            write_bag(rosbag2.Writer(folder / name, version=9, storage_plugin=plugin), half, store)
        return joined(folder / "a", folder / "b")
    writer = rosbag2.Writer(folder / "a", version=9, storage_plugin=plugin)
    if how:
        mode = rosbag2.CompressionMode[how.upper()]
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
    write_bag(writer, rows, store)
    return folder / "a"


def joined(first: Path, second: Path) -> Path:
    """The files of the second bag as the last of the first, as a recorder splits one."""
    a, b = (yaml.safe_load((path / "metadata.yaml").read_text()) for path in (first, second))
    for file in second.iterdir():
        if file.suffix != ".yaml":
            move(file, first)
    top = "rosbag2_bagfile_information"
    for name in ("relative_file_paths", "files"):
        a[top][name] += b[top][name]
    a[top]["message_count"] += b[top]["message_count"]
    counted = {t["topic_metadata"]["name"]: t for t in a[top]["topics_with_message_count"]}
    for topic in b[top]["topics_with_message_count"]:
        name = topic["topic_metadata"]["name"]
        if name in counted:
            counted[name]["message_count"] += topic["message_count"]
        else:
            a[top]["topics_with_message_count"].append(topic)
    (first / "metadata.yaml").write_text(yaml.safe_dump(a))
    return first


@pytest.mark.parametrize("metadata", [True, False], ids=["", "no_metadata"])
@pytest.mark.parametrize(
    "kind",
    [
        *("ros1", "ros1-lz4", "ros1-bz2", "sqlite3", "mcap", "sqlite3-split", "mcap-split"),
        *("sqlite3-message", "sqlite3-file", "mcap-storage"),
    ],
)
def test_older_drivers_bag_gives_its_events_and_camera(
    tmp_path: Path, make_events: Any, kind: str, metadata: bool
) -> None:
    parts = [make_events(50, start_s=1 + 0.05 * i) for i in range(4)]
    path = make_bag(tmp_path, kind, parts)
    if not metadata:
        if kind.startswith("ros1") or kind in ("sqlite3-message", "sqlite3-file"):
            pytest.skip("a bag of this kind has no metadata.yaml, or cannot be read without it")
        (path / "metadata.yaml").unlink()
    with open_recording(path) as recording:
        assert recording.topic == TOPIC
        assert recording.camera is not None
        assert recording.camera.size == (32, 24)
        read = Events.concatenate(list(recording.event_chunks()))
        since = Events.concatenate(list(recording.event_chunks(1_100_000_000)))
    written = Events.concatenate(parts)
    for name in ("x", "y", "t", "p"):
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
    np.testing.assert_array_equal(since.t, written.t[written.t >= 1_100_000_000])
