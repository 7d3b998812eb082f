import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from emoflow_ros.commands.info import inspect, main
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation.messages import CAMERA_INFO, EVENT_ARRAY, MessageEncoder

DATA = Path(__file__).parents[3] / "shared" / "data"


@pytest.fixture
def recordings() -> Path:
    if not DATA.is_dir():
        pytest.skip("no real recordings beside the repository (../shared/data)")
    return DATA


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag(tmp_path, storage, make_events, write_event_bag):
    events = make_events(101)
    path = tmp_path / ("a.bag" if storage == "ros1" else "a")
    write_event_bag(path, [events[:40], events[40:]], storage=storage)
    info = inspect(path)
    (topic,) = info.topics
    assert (topic.name, topic.type) == ("/cam/events", "dvs_msgs/msg/EventArray")
    assert (topic.width, topic.height) == (32, 24)
    assert (topic.events, topic.on, topic.off) == (101, 51, 50)
    assert (topic.t_first, topic.t_last) == (1.0, 1.1)
    assert topic.rate == pytest.approx(1010)
    assert (topic.packets, topic.malformed, topic.unordered, topic.outside) == (2, 0, 0, 0)
    assert info.other_topics == [
        {"name": "/cam/camera_info", "type": "sensor_msgs/msg/CameraInfo", "messages": 1}
    ]
    assert info.missing == []


def test_what_is_missing_and_what_is_wrong(tmp_path, make_events, write_event_bag):
    events = make_events(100)
    batches = [events[50:], events[:50]]
    topics = ("/left/events", "/right/events")
    path = write_event_bag(
        tmp_path / "a.bag", batches, topics=topics, size=(20, 24), with_info=False
    )
    info = inspect(path)
    assert [t.name for t in info.topics] == list(topics)
    for topic in info.topics:
        assert topic.unordered == np.count_nonzero(events.x[50:] < 20)
        assert topic.outside == np.count_nonzero(events.x >= 20)
        assert topic.events == 100 - topic.outside - topic.unordered
    assert [line.partition(": give")[0] for line in info.missing] == [
        *(f"{t}: no calibration" for t in topics),
        *(f"{t}: event times are not sorted" for t in topics),
    ]


def test_bag_without_events(tmp_path, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [], topics=())
    info = inspect(path)
    assert info.topics == []
    assert info.missing == ["no topic of a known event type"]
    path = write_event_bag(tmp_path / "b.bag", [Events.empty()])
    info = inspect(path)
    assert info.topics[0].t_first is None
    assert info.missing == ["/cam/events: no events"]


def test_file(tmp_path):
    path = tmp_path / "a.npz"
    k = np.arange(11)
    np.savez(path, x=k, y=k, t=k * 0.1, p=k % 2, width=346, height=260)
    (topic,) = inspect(path).topics
    assert (topic.width, topic.height, topic.events, topic.on) == (346, 260, 11, 5)
    assert topic.rate == pytest.approx(11)


def write_clouds(path: Path, topics: dict[str, str]) -> Path:
    """Write one PointCloud2 of 2000 points for each topic: x, y, p as u2 and the given field."""
    types = get_typestore(Stores.ROS2_JAZZY)
    cloud, field = (types.types[f"sensor_msgs/msg/{n}"] for n in ("PointCloud2", "PointField"))
    header, time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    k = np.arange(2000)
    points = np.stack([k % 300, k % 200, k % 2, k], axis=1).astype("<u2")
    with rosbag2.Writer(path, version=9) as writer:
        for topic, last in topics.items():
            fields = [field(n, 2 * i, 4, 1) for i, n in enumerate(("x", "y", "p", last))]
            data = points.view(np.uint8).ravel()
            message = cloud(header(time(5, 0), "cam"), 1, 2000, fields, False, 8, 8, data, True)
            connection = writer.add_connection(topic, cloud.__msgtype__, typestore=types)
            writer.write(connection, 5, types.serialize_cdr(message, cloud.__msgtype__))
    return path


def test_events_of_an_unknown_sensor_are_all_inside(tmp_path):
    path = write_clouds(tmp_path / "clouds", {"/cam/events": "t_us"})
    (topic,) = inspect(path).topics
    assert (topic.width, topic.height) == (0, 0)
    assert (topic.events, topic.outside) == (2000, 0)
    with open_recording(path) as recording:
        assert sum(map(len, recording.event_chunks())) == 2000


def test_clouds_without_events_are_another_topic(tmp_path):
    path = write_clouds(tmp_path / "clouds", {"/cam/events": "t_us", "/lidar": "intensity"})
    info = inspect(path)
    assert [t.name for t in info.topics] == ["/cam/events"]
    assert info.other_topics == [
        {"name": "/lidar", "type": "sensor_msgs/msg/PointCloud2", "messages": 1}
    ]


@pytest.mark.parametrize(
    ("size", "focal", "words"),
    [
        ((32, 24), 20.0, None),
        ((64, 48), 20.0, "camera_info is of a 64x48 sensor"),
        ((32, 24), 0.0, "camera_info cannot be used (/cam/camera_info: focal lengths fx=0.0"),
    ],
)
def test_camera_info_that_does_not_serve(tmp_path, make_events, size, focal, words):
    encoder = MessageEncoder(ros1=False)
    camera = Camera(*size, 20.0, 20.0, 16.0, 12.0)
    camera_info = encoder.camera_info(0, camera)
    messages = {
        EVENT_ARRAY: encoder.events(0, Camera(32, 24, 20.0, 20.0, 16.0, 12.0), make_events(10)),
        CAMERA_INFO: camera_info.replace(struct.pack("<d", 20.0), struct.pack("<d", focal)),
    }
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        for name, (ros_type, data) in zip(("events", "camera_info"), messages.items(), strict=True):
            connection = writer.add_connection(
                f"/cam/{name}", ros_type, typestore=encoder.typestore
            )
            writer.write(connection, 5, data)
    missing = inspect(tmp_path / "bag").missing
    assert len(missing) == (words is not None)
    assert all(line.startswith(f"/cam/events: {words}") for line in missing)


def test_ecd_folder_without_calibration(tmp_path):
    (tmp_path / "events.txt").write_text("0.1 1 2 1\n0.2 500 2 0\n")
    info = inspect(tmp_path)
    (topic,) = info.topics
    assert (topic.width, topic.height, topic.events, topic.on) == (0, 0, 2, 1)
    (missing,) = info.missing
    assert missing.startswith("no calibration")


def test_missing_input(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        inspect(tmp_path / "no.bag")


@pytest.mark.parametrize("name", ["test_events_1", "test_events_1.bag"])
def test_recorded_evt3(recordings, name):
    (topic,) = inspect(recordings / "event_packets" / name).topics
    assert (topic.encoding, topic.width, topic.height) == ("evt3", 640, 480)
    assert (topic.events, topic.on, topic.off) == (343_474, 125_183, 218_291)
    assert (topic.t_first, topic.t_last) == (7.139845, 9.218023)
    assert (topic.packets, topic.seq_gaps) == (517, 0)


def run_main(monkeypatch, capsys, *arguments: object) -> tuple[int, str, str]:
    monkeypatch.setattr(sys, "argv", ["info", *map(str, arguments)])
    code = main()
    return code, *capsys.readouterr()


@pytest.mark.parametrize("damage", ["empty", "cut"])
def test_messages_of_events_without_any_event_are_an_error(
    monkeypatch, capsys, tmp_path, make_events, write_event_bag, damage
):
    """What else it holds is said nevertheless, as text and as JSON."""
    events = Events.empty() if damage == "empty" else make_events(10)
    path = write_event_bag(tmp_path / "a.bag", [events], with_info=True)
    if damage == "cut":
        count = struct.pack("<I", 10)
        data = path.read_bytes()
        at = data.index(count, data.index(struct.pack("<II", 24, 32))) + len(count) - 1
        path.write_bytes(data[:at] + b"\x7f" + data[at + 1 :])
    line = f"error: {path}: 1 messages of events on /cam/events, and no event in them; "
    code, out, err = run_main(monkeypatch, capsys, path)
    assert (code, err.startswith(line)) == (2, True), err
    assert "/cam/camera_info" in out
    code, out, _ = run_main(monkeypatch, capsys, path, "--json")
    assert (code, json.loads(out)["topics"][0]["events"]) == (2, 0)


def test_a_bag_of_other_topics_is_described(monkeypatch, capsys, tmp_path, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [], topics=())
    code, out, err = run_main(monkeypatch, capsys, path)
    assert (code, err) == (0, "")
    assert "missing: no topic of a known event type" in out
    path = write_event_bag(tmp_path / "b.bag", [])  # a topic on which nothing was recorded
    code, out, err = run_main(monkeypatch, capsys, path)
    assert (code, err) == (0, "")
    assert "missing: /cam/events: no events" in out


def test_json(monkeypatch, capsys, tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(10)])
    code, out, _ = run_main(monkeypatch, capsys, path, "--json")
    assert code == 0
    (topic,) = json.loads(out)["topics"]
    assert topic["name"] == "/cam/events"
    assert topic["events"] == 10


def test_text(monkeypatch, capsys, recordings):
    code, out, _ = run_main(monkeypatch, capsys, recordings / "event_packets" / "test_events_2")
    assert code == 0
    for words in (
        "/event_camera/events: event_camera_msgs/msg/EventPacket",
        "libcaer_cmp",
        "346x260",
        "571266 (211043 ON, 360223 OFF)",
        "1744227144.732712",
        "100 (0 lost)",
        "missing: /event_camera/events: no calibration",
    ):
        assert words in out


def test_error_is_one_line(monkeypatch, capsys, tmp_path):
    code, out, err = run_main(monkeypatch, capsys, tmp_path / "no.bag")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith("error: ")
