"""Recordings: what comes out of them, and the one line for everything that is wrong."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording, require_camera

DATA = Path(__file__).parents[3] / "shared" / "data"
CALIB = "20 20 16 12 0.1 0 0 0 0"


def read_all(path, **options) -> Events:
    with open_recording(path, **options) as recording:
        return Events.concatenate(list(recording.event_chunks()))


def ecd_folder(folder, lines, calibration=CALIB):
    folder.mkdir(exist_ok=True)
    (folder / "events.txt").write_text("\n".join(lines) + ("\n" if lines else ""))
    if calibration:
        (folder / "calib.txt").write_text(calibration)
    return folder


def assert_refused(path, *words, **options):
    with pytest.raises(InputError) as error:
        read_all(path, **options)
    line = str(error.value)
    assert line.startswith(str(path)), line
    assert "\n" not in line
    for word in words:
        assert word in line


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bag_gives_back_events_and_camera(tmp_path, storage, make_events, write_event_bag):
    written = make_events(100)
    path = tmp_path / ("a.bag" if storage == "ros1" else "a")
    write_event_bag(path, [written[:40], written[40:]], storage=storage)
    with open_recording(path) as recording:
        assert recording.topic == "/cam/events"
        assert (recording.camera.width, recording.camera.height) == (32, 24)
        assert (recording.camera.fx, recording.camera.model) == (20.0, "plumb_bob")
        chunks = list(recording.event_chunks())
    for name in ("x", "y", "t", "p"):
        read = np.concatenate([getattr(c, name) for c in chunks])
        np.testing.assert_array_equal(read, getattr(written, name))


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_storage_file_alone_and_folder_without_metadata(
    tmp_path, storage, make_events, write_event_bag
):
    folder = write_event_bag(tmp_path / "a", [make_events(50)], storage=storage)
    file = next(f for f in folder.iterdir() if f.suffix in (".db3", ".mcap"))
    assert len(read_all(file)) == 50
    (folder / "metadata.yaml").unlink()
    assert len(read_all(folder)) == 50


def test_calibration_file_takes_the_place_of_camera_info(tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(5)])
    file = tmp_path / "calib.yaml"
    file.write_text(
        "{image_width: 32, image_height: 24, camera_matrix: {data: [9,0,1,0,9,2,0,0,1]},"
        " distortion_model: equidistant, distortion_coefficients: {data: [0,0,0,0]}}"
    )
    with open_recording(path, calibration=file) as recording:
        assert (recording.camera.fx, recording.camera.model) == (9.0, "equidistant")


def test_missing_file(tmp_path):
    assert_refused(tmp_path / "none.bag", "no such file")


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3"])
def test_empty_and_non_bag_files(tmp_path, name):
    path = tmp_path / name
    path.touch()
    assert_refused(path, "empty file")
    path.write_bytes(b"%PDF-1.4 something else entirely" * 10)
    assert_refused(path, "not a bag")


def test_unknown_format(tmp_path):
    path = tmp_path / "notes.docx"
    path.write_text("hello")
    assert_refused(path, "known format", "ECD folder")


@pytest.mark.parametrize(  # of one chunk: nothing is whole; that of ROS 1 has messages from 0.1 on
    ("storage", "share"),
    [("ros1", 0.02), *((s, share) for s in ("sqlite3", "mcap") for share in (0.02, 0.3, 0.6, 0.9))],
)
def test_truncated_bag(tmp_path, storage, share, make_events, write_event_bag):
    path = write_event_bag(
        tmp_path / ("a.bag" if storage == "ros1" else "a"),
        [make_events(500, start_s=1 + i) for i in range(20)],
        storage=storage,
    )
    if storage != "ros1":
        path = next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    assert_refused(path, "damaged bag", "copy it again")


def test_database_without_tables(tmp_path):
    path = tmp_path / "a.db3"
    with sqlite3.connect(path) as database:
        database.execute("CREATE TABLE other (id INTEGER)")
    assert_refused(path, "damaged bag")


def test_bag_without_an_event_topic_lists_what_is_there(tmp_path, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [], topics=())
    assert_refused(
        path, "no topic of a known event type", "/cam/camera_info (sensor_msgs/msg/CameraInfo)"
    )


def test_two_event_topics_ask_for_one(tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(7)], topics=("/l/events", "/r/events"))
    assert_refused(path, "2 event topics: /l/events, /r/events", "--topic")
    assert len(read_all(path, topic="/r/events")) == 7
    assert_refused(path, "no event topic '/x'", "give one of /l/events, /r/events", topic="/x")


def test_no_calibration_names_the_option(tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(5)], with_info=False)
    with open_recording(path) as recording, pytest.raises(InputError, match="--calib FILE"):
        require_camera(recording)


def test_calibration_of_another_sensor(tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(5)])
    file = tmp_path / "calib.txt"
    file.write_text(CALIB)
    assert_refused(path, "events of a 32x24 sensor", "240x180", calibration=file)


def test_damaged_message(tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(50)])
    data = path.read_bytes()
    at = data.index(b"\3\0\0\0cam") + 7 + 8  # the number of events
    path.write_bytes(data[:at] + b"\xff\xff\xff\x7f" + data[at + 4 :])
    assert_refused(path, "damaged message on /cam/events")


def test_bag_with_messages_but_no_events(tmp_path, make_events, write_event_bag):
    assert_refused(write_event_bag(tmp_path / "a.bag", [make_events(0)]), "holds no events")
    assert_refused(write_event_bag(tmp_path / "b.bag", []), "no messages on /cam/events")


def test_bag_with_unsorted_times(tmp_path, make_events, write_event_bag):
    batches = [make_events(10, start_s=2.0), make_events(10, start_s=1.5)]
    path = write_event_bag(tmp_path / "a.bag", batches)
    assert_refused(
        path, "not sorted (1.500000 s follows 2.009000 s, and 10 of 20 events are earlier"
    )


def test_bag_with_events_outside_the_sensor(tmp_path, make_events, write_event_bag):
    path = write_event_bag(tmp_path / "a.bag", [make_events(2000)], size=(32, 12))
    assert_refused(path, "of 2000 events lie outside the 32x12 sensor", "calibration")


def test_a_few_stray_events_are_dropped(tmp_path, make_events, write_event_bag):
    events = make_events(2000)
    events.x[7] = 999
    path = write_event_bag(tmp_path / "a.bag", [events])
    assert len(read_all(path)) == 1999


def test_ecd_folder(tmp_path):
    read = read_all(ecd_folder(tmp_path / "e", ["0.5 1 2 1", "0.500001 239 179 0"]))
    np.testing.assert_array_equal(read.t, [500_000_000, 500_001_000])
    np.testing.assert_array_equal(read.x, [1, 239])
    np.testing.assert_array_equal(read.y, [2, 179])
    np.testing.assert_array_equal(read.p, [True, False])


def test_ecd_is_read_in_chunks_without_loss(tmp_path, monkeypatch):
    monkeypatch.setattr("emoflow_ros.readers.ecd._CHUNK_BYTES", 64)
    lines = [f"{k * 1e-3:.6f} {k} 1 1" for k in range(100)]
    with open_recording(ecd_folder(tmp_path / "e", lines)) as recording:
        chunks = list(recording.event_chunks())
    assert len(chunks) > 10
    np.testing.assert_array_equal(np.concatenate([c.x for c in chunks]), np.arange(100))


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], "no events"),
        (["0.1 1 2 1", "0.2 240 2 1"], "1 of 2 events lie outside the 240x180 sensor"),
        (["0.1 1 2 1", "0.2 -1 2 1"], "1 of 2 events lie outside"),
        (
            ["0.2 1 2 1", "0.1 1 2 1"],
            "not sorted (0.100000 s follows 0.200000 s, and 1 of 2 events",
        ),
        (["0.1 1 2 1", "0.2 1 2"], "lines of 3 numbers"),
        (["0.1 1 2 1", "0.2 1 2", "0.3 1 2 1"], "not a table of numbers"),
        (["0.1 1 2 1", "nan 1 2 1"], "not finite"),
        (["a b c d", "0.1 1 2 1"], "not a table of numbers"),
    ],
)
def test_ecd_bad_events(tmp_path, lines, words):
    folder = ecd_folder(tmp_path / "e", lines)
    with pytest.raises(InputError) as error:
        read_all(folder)
    assert str(error.value).startswith(str(folder / "events.txt"))
    assert words in str(error.value)


def test_ecd_without_calibration(tmp_path):
    folder = ecd_folder(tmp_path / "e", ["0.1 1 2 1", "0.2 500 2 1"], calibration=None)
    assert len(read_all(folder)) == 2
    with open_recording(folder) as recording, pytest.raises(InputError, match="--calib FILE"):
        require_camera(recording)


@pytest.mark.parametrize(
    ("name", "events", "on", "size"),
    [
        ("test_events_1.bag", 343_474, 125_183, (640, 480)),
        ("test_events_1", 343_474, 125_183, (640, 480)),
        ("test_events_2", 571_266, 211_043, (346, 260)),
    ],
)
def test_real_event_packets(name, events, on, size):
    path = DATA / "event_packets" / name
    if not path.exists():
        pytest.skip("the recordings in ../shared/data are not here")
    read = read_all(path)
    assert (len(read), int(read.p.sum())) == (events, on)
    assert read.x.max() < size[0]
    assert read.y.max() < size[1]


@pytest.mark.parametrize(("name", "n"), [("shapes_rotation", 20_000), ("dynamic_rotation", 30_000)])
def test_real_ecd(name, n):
    path = DATA / "ecd" / name
    if not path.exists():
        pytest.skip("the recordings in ../shared/data are not here")
    assert len(read_all(path)) == n
