import json
import sys
from pathlib import Path

import numpy as np
import pytest

from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.offline.info import inspect, main

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
    assert (topic.packets, topic.malformed, topic.unsorted, topic.outside) == (2, 0, 0, 0)
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
        assert topic.unsorted == 1
        assert topic.outside == np.count_nonzero(events.x >= 20)
        assert topic.events == 100 - topic.outside
    assert info.missing == [f"{t}: no calibration: give one with --calib FILE" for t in topics]


def test_bag_without_events(tmp_path, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [], topics=())
    info = inspect(path)
    assert info.topics == []
    assert info.missing == ["no event topic"]
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
