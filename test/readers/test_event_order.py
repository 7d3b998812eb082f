"""Events out of order in recordings: left out and counted by every command, of every format."""

import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from event_bags import make_events, write_event_bag

sys.path.append(str(Path(__file__).parents[1] / "msg_adapters"))
from encoders import evt3

from emoflow_ros.commands import evaluate as evaluate_command
from emoflow_ros.commands import label as label_command
from emoflow_ros.commands.info import inspect
from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording, unordered

COUNT = 3000  # at 1 kHz
SIZE = (32, 24)
WRONG = [77, 500, 1999, 2998]
CALIBRATION = """image_width: 32
image_height: 24
camera_name: camera
camera_matrix: {rows: 3, cols: 3, data: [20.0, 0, 16, 0, 20, 12, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""


@pytest.fixture
def events() -> Events:
    """Four single events too early, by 20 us to 1 s beyond the one before them."""
    events = make_events(COUNT)
    events.t[WRONG] -= np.array([1_020_000, 5_000_000, 100_000_000, 1_000_000_000])
    return events


def batches(events: Events) -> list[Events]:
    return [events[k : k + 100] for k in range(0, len(events), 100)]


def write_bag(storage: str):
    def write(folder: Path, events: Events) -> Path:
        path = folder / ("a.bag" if storage == "ros1" else "a")
        times = [int(events.t[0]) + k * 100_000_000 for k in range(len(events) // 100)]
        return write_event_bag(path, batches(events), storage=storage, log_times=times)

    return write


def write_npz(folder: Path, events: Events) -> Path:
    np.savez(folder / "a.npz", x=events.x, y=events.y, t_ns=events.t, p=events.p)
    return folder / "a.npz"


def write_ecd(folder: Path, events: Events) -> Path:
    rows = zip(events.t / 1e9, events.x, events.y, events.p, strict=True)
    (folder / "events.txt").write_text("".join(f"{t:.9f} {x} {y} {p:d}\n" for t, x, y, p in rows))
    return folder / "events.txt"


def write_hdf5(folder: Path, events: Events) -> Path:
    with h5py.File(folder / "a.h5", "w") as file:
        for name, column in (("x", events.x), ("y", events.y), ("p", events.p)):
            file[f"events/{name}"] = column
        file["events/t"] = events.t
        file["events/t"].attrs["unit"] = "ns"
    return folder / "a.h5"


def write_mvsec(folder: Path, events: Events) -> Path:
    with h5py.File(folder / "a_data.hdf5", "w") as file:
        table = [events.x, events.y, events.t / 1e9, np.where(events.p, 1, -1)]
        file["davis/left/events"] = np.stack(table, axis=1)
    return folder / "a_data.hdf5"


WRITERS = {
    "ros1": write_bag("ros1"),
    "sqlite3": write_bag("sqlite3"),
    "mcap": write_bag("mcap"),
    "npz": write_npz,
    "ecd": write_ecd,
    "hdf5": write_hdf5,
    "mvsec": write_mvsec,
}


@pytest.mark.parametrize("name", WRITERS)
def test_readers_leave_them_out_and_count_them(tmp_path, events, name):
    path = WRITERS[name](tmp_path, events)
    with open_recording(path) as recording:
        assert unordered(recording) == 0
        read = Events.concatenate(list(recording.event_chunks()))
        assert unordered(recording) == 4
    expected = np.delete(events.t, WRONG)
    np.testing.assert_allclose(read.t, expected, atol=0 if name != "mvsec" else 1000)
    np.testing.assert_array_equal(read.x, np.delete(events.x, WRONG))
    [topic] = inspect(path).topics
    assert (topic.events, topic.unordered, topic.time_jumps) == (COUNT - 4, 4, 0)


@pytest.mark.parametrize("name", WRITERS)
def test_recording_that_goes_back_for_good_is_refused(tmp_path, name):
    """Two runs in one file."""
    both = Events.concatenate([make_events(1000, start_s=5), make_events(1000, start_s=4.5)])
    path = WRITERS[name](tmp_path, both)
    with open_recording(path) as recording, pytest.raises(InputError) as caught:
        list(recording.event_chunks())
    said = "event time goes back for good (4.500000 s follows 5.999000 s): the sensor's clock or"
    assert said in str(caught.value)
    assert str(caught.value).endswith("; give each part as a recording of its own")
    if name in ("ros1", "sqlite3", "mcap"):
        info = inspect(path)
        assert (info.topics[0].time_jumps, info.topics[0].events) == (1, 2000)
        assert any("event time goes back for good: give each part" in m for m in info.missing)


@pytest.mark.parametrize("length", [60, 150, 1000])
def test_info_counts_every_round_of_a_loop(tmp_path, length):
    """Messages of 30 ms: some have the end of a round and the beginning of the next."""
    rounds = Events.concatenate([make_events(length, start_s=5) for _ in range(5)])
    parts = [rounds[k : k + 30] for k in range(0, len(rounds), 30)]
    [topic] = inspect(write_event_bag(tmp_path / "a.bag", parts)).topics
    assert topic.events + topic.unordered == 5 * length
    if length > 100:
        assert (topic.time_jumps, topic.unordered) == (4, 0)


@pytest.mark.parametrize("name", WRITERS)
def test_recording_that_is_not_sorted_is_refused(tmp_path, name):
    events = make_events(1000)
    shuffled = np.arange(1000).reshape(-1, 20)[:, ::-1].ravel()  # each 20 ms backwards
    with (
        open_recording(WRITERS[name](tmp_path, events[shuffled])) as recording,
        pytest.raises(
            InputError, match=r"not sorted \(1.018000 s follows 1.019000 s, and 950 of 10"
        ),
    ):
        list(recording.event_chunks())


@pytest.mark.parametrize(("file", "wrong"), [("one_back_99ms.bag", 1), ("four_back_1s.bag", 2)])
def test_field_recordings(shared_data, file, wrong):
    path = shared_data / "field" / file
    with open_recording(path) as recording:
        read = Events.concatenate(list(recording.event_chunks()))
        assert (len(read), unordered(recording)) == (28366 - wrong, wrong)
    assert (np.diff(read.t) >= 0).all()
    [topic] = inspect(path).topics
    assert (topic.events, topic.unordered) == (28366 - wrong, wrong)


@pytest.mark.parametrize("counts", [(-1, 1), (-3, 2), (-200, 150), (-240, 2000)])
def test_jitter_of_evt3_time_costs_the_events_that_have_it(tmp_path, counts):
    """Some upper halves of the time are wrong by these numbers of 4.096 ms, for 4 ms each."""
    events = make_events(50_000, *SIZE)
    events.t[:] = 20_000_000_000 + np.arange(50_000) * 20_000
    words = evt3(events)
    highs = np.flatnonzero(words >> 12 == 0x8)
    wrong = highs[np.array([20, 41, 83, 120, 160, 201])]
    words[wrong] = 0x8000 | (words[wrong] + np.resize(counts, 6)) & 0xFFF
    path = tmp_path / "a.raw"
    path.write_bytes(b"% evt 3.0\n% geometry 32x24\n% end\n" + words.tobytes())
    with open_recording(path) as recording:
        read = Events.concatenate(list(recording.event_chunks()))
        left_out = unordered(recording)
    assert left_out + len(read) == 50_000
    assert 600 <= left_out <= 6 * 206
    shift = read.t[0] - events.t[0]  # whole wraps before the start are unknowable
    assert len(np.intersect1d(read.t - shift, events.t)) >= len(read) - 6 * 206


@pytest.fixture
def calibration(tmp_path) -> Path:
    path = tmp_path / "camera.yaml"
    path.write_text(CALIBRATION)
    return path


def test_evaluate_and_its_report_say_how_many(
    tmp_path, events, calibration, monkeypatch, capsys, without_page
):
    path = write_npz(tmp_path, events)
    arguments = ["evaluate", path, "--calib", calibration, "--out", tmp_path / "out"]
    monkeypatch.setattr(sys, "argv", list(map(str, arguments)))
    assert evaluate_command.main() in (0, 1)
    assert "windows estimated, 4 events out of order left out\n" in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["events_unordered"] == 4


@pytest.mark.parametrize("chunk_s", [0.4, 30])
def test_labels_say_how_many_however_they_are_divided(
    tmp_path, events, calibration, monkeypatch, capsys, chunk_s
):
    path = write_bag("mcap")(tmp_path, events)
    arguments = ["label", path, "--calib", calibration, "--out", tmp_path, "--chunk-s", chunk_s]
    monkeypatch.setattr(sys, "argv", list(map(str, [*arguments, "--window-ms", 100])))
    assert label_command.main() == 1  # too few events for an estimate
    said = capsys.readouterr()
    assert "0 of 29 windows estimated, 3 events out of order left out" in said.out
    assert f"{path}: none of its 29 windows could be estimated; " in said.err
    with h5py.File(tmp_path / "a.h5") as file:
        assert file.attrs["events_unordered"] == 3  # the last one is behind the last window
