"""Recordings in one file: what comes out of them, and the one line for everything wrong."""

import sys
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest
from event_bags import assert_equal

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording

# 200 events, written by dv-processing
AEDAT4 = Path(__file__).parents[1] / "recordings" / "events.aedat4"


@pytest.fixture
def events() -> Events:
    """Events with times in whole microseconds."""
    k = np.arange(500)
    x, y = (k * 7 % 346).astype(np.uint16), (k * 3 % 260).astype(np.uint16)
    return Events(x, y, (5_000_000 + k * 37) * 1000, k % 3 == 0)


def read_all(path: Path, **options) -> Events:
    with open_recording(path, **options) as recording:
        return Events.concatenate(list(recording.event_chunks()))


def assert_refused(path: Path, *words: str, **options) -> None:
    with pytest.raises(InputError) as error:
        read_all(path, **options)
    line = str(error.value)
    assert line.startswith(str(path))
    assert "\n" not in line
    for word in words:
        assert word in line


def evt2(events: Events) -> bytes:
    words = []
    for x, y, us, p in zip(events.x, events.y, events.t // 1000, events.p, strict=True):
        words += [
            8 << 28 | int(us) >> 6,
            int(p) << 28 | (int(us) & 63) << 22 | int(x) << 11 | int(y),
        ]
    return np.array(words, "<u4").tobytes()


def evt21(events: Events, upper_first: bool = False) -> bytes:
    words = []
    for x, y, us, p in zip(events.x, events.y, events.t // 1000, events.p, strict=True):
        x, us = int(x), int(us)
        address = int(p) << 28 | (us & 63) << 22 | (x & ~31) << 11 | int(y)
        words += [8 << 60 | us >> 6 << 32, address << 32 | 1 << (x & 31)]
    words = np.array(words, "<u8")
    return (words << 32 | words >> 32 if upper_first else words).tobytes()


def evt3(events: Events) -> bytes:
    words = []
    for x, y, us, p in zip(events.x, events.y, events.t // 1000, events.p, strict=True):
        us = int(us)
        words += [0x8000 | us >> 12 & 0xFFF, 0x6000 | us & 0xFFF, int(y)]
        words += [0x2000 | int(p) << 11 | int(x)]
    return np.array(words, "<u2").tobytes()


def write_raw(path: Path, header: str, data: bytes) -> Path:
    path.write_bytes(header.encode() + data)
    return path


@pytest.mark.parametrize(
    ("header", "encode"),
    [
        ("% evt 3.0\n% format EVT3;height=260;width=346\n% geometry 346x260\n% end\n", evt3),
        ("% date 2023-03-29 16:37:46\n% format EVT3;height=260;width=346\n", evt3),
        ("% evt 2.0\n% geometry 346x260\n% end\n", evt2),
        ("% format EVT21;endianness=little;height=260;width=346\n% end\n", evt21),
        (
            "% format EVT21;endianness=legacy;height=260;width=346\n% end\n",
            lambda events: evt21(events, upper_first=True),
        ),
    ],
)
def test_prophesee_raw(tmp_path, events, header, encode):
    path = write_raw(tmp_path / "a.raw", header, encode(events))
    assert_equal(read_all(path), events)
    with open_recording(path) as recording:
        assert recording.size == (346, 260)


def test_prophesee_raw_across_chunks(tmp_path, events):
    longer = Events.concatenate(
        [Events(events.x, events.y, events.t + i * 20_000_000, events.p) for i in range(300)]
    )
    header = "% evt 3.0\n% geometry 346x260\n% end\n"
    path = write_raw(tmp_path / "a.raw", header, evt3(longer))
    assert path.stat().st_size > 1 << 20
    assert_equal(read_all(path), longer)


def test_prophesee_raw_of_unknown_format(tmp_path):
    path = write_raw(tmp_path / "a.raw", "% format HISTO3D\n% end\n", b"")
    assert_refused(path, "'HISTO3D'", "EVT2 or EVT21 or EVT3")
    assert_refused(write_raw(tmp_path / "b.raw", "", b"1234"), "without a format")


def test_prophesee_raw_without_events(tmp_path):
    assert_refused(write_raw(tmp_path / "a.raw", "% evt 3.0\n% end\n", b""), "holds no events")


def test_aedat4():
    pytest.importorskip("aedat", reason="the optional package aedat is not installed")
    k = np.arange(200)
    x, y = (7 * k % 346).astype(np.uint16), (3 * k % 260).astype(np.uint16)
    expected = Events(x, y, (1_000_000 + 10 * k) * 1000, k % 3 == 0)
    assert_equal(read_all(AEDAT4), expected)


def test_aedat4_damaged(tmp_path):
    pytest.importorskip("aedat", reason="the optional package aedat is not installed")
    for name, data in (("cut", AEDAT4.read_bytes()[:1500]), ("other", b"123"), ("empty", b"")):
        path = tmp_path / f"{name}.aedat4"
        path.write_bytes(data)
        assert_refused(path, "damaged AEDAT4 file")


def test_aedat4_names_its_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "aedat", None)
    assert_refused(AEDAT4, "needs the package 'aedat'", "pip install aedat")


def write_dsec(path: Path, events: Events, offset_us: int) -> Path:
    columns = {
        "x": events.x,
        "y": events.y,
        "t": (events.t // 1000 - offset_us).astype(np.uint32),
        "p": events.p.astype(np.uint8),
    }
    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file.create_dataset(
                f"events/{name}", data=column, chunks=(100,), **hdf5plugin.Blosc(cname="zstd")
            )
        file["t_offset"] = offset_us
    return path


def test_dsec(tmp_path, events):
    path = write_dsec(tmp_path / "events.h5", events, 4_000_000)
    assert_equal(read_all(path), events)
    with open_recording(path) as recording:
        assert recording.duration == pytest.approx(499 * 37e-6)


def test_dsec_columns_of_different_lengths(tmp_path, events):
    path = write_dsec(tmp_path / "events.h5", events, 0)
    with h5py.File(path, "a") as file:
        del file["events/p"]
        file["events/p"] = np.zeros(3)
    assert_refused(path, "different lengths")


def test_mvsec(tmp_path, events):
    path = tmp_path / "indoor_flying1_data.hdf5"
    epoch = 1_504_645_177  # s: doubles resolve 0.24 us there, which is no error of whole us
    p = np.where(events.p, 1, -1)
    right = events[::2]
    with h5py.File(path, "w") as file:
        table = np.stack([events.x, events.y, epoch + events.t / 1e9, p], axis=1)
        file["davis/left/events"] = table
        file["davis/right/events"] = table[::2]
    read = read_all(path)
    assert_equal(Events(read.x, read.y, read.t - epoch * 10**9, read.p), events)
    assert len(read_all(path, topic="davis/right/events")) == len(right)
    assert_refused(path, "no event table 'cam0'", "davis/left/events", topic="cam0")


def test_damaged_hdf5(tmp_path, events):
    path = write_dsec(tmp_path / "events.h5", events, 0)
    path.write_bytes(path.read_bytes()[:600])
    assert_refused(path, "damaged HDF5 file")


@pytest.mark.parametrize(
    ("name", "dtype", "per_us"),
    [
        ("t", "f8", 1e-6),
        ("t", "i8", 1),
        ("t_us", "i8", 1),
        ("t_us", "f8", 1),
        ("t_ns", "i8", 1000),
        ("t_s", "f8", 1e-6),
    ],
)
def test_npz(tmp_path, events, name, dtype, per_us):
    path = tmp_path / "a.npz"
    t = (events.t // 1000 * per_us).astype(dtype)
    polarity = np.where(events.p, 1, -1)
    np.savez(
        path, x=events.x, y=events.y.astype(float), p=polarity, width=346, height=260, **{name: t}
    )
    assert_equal(read_all(path), events)


def test_npz_with_epoch_nanoseconds(tmp_path, events):
    path = tmp_path / "a.npz"
    t = events.t + 1_700_000_000_000_000_000
    np.savez(path, x=events.x, y=events.y, t=t, p=events.p)
    np.testing.assert_array_equal(read_all(path).t, t)


def test_npz_that_cannot_be_used(tmp_path):
    columns = {name: np.zeros(3) for name in "xytp"}
    path = tmp_path / "a.npz"
    np.savez(path, **{k: columns[k] for k in "xy"})
    assert_refused(path, "no array t, p")
    np.savez(path, **columns | {"p": np.zeros(4)})
    assert_refused(path, "different shapes")
    np.savez(path, **columns | {"t": np.array([0, np.nan, 1])})
    assert_refused(path, "not finite")
    np.savez(path, **columns | {"t": np.array([0.0, 2.0, 1.0])})
    assert_refused(path, "not sorted")
    path.write_bytes(b"123")
    assert_refused(path, "not a NumPy archive")


def test_calibration_of_another_size(tmp_path, events):
    calib = tmp_path / "calib.yaml"
    calib.write_text(
        "image_width: 640\nimage_height: 480\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [300, 0, 320, 0, 300, 240, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}\n"
    )
    path = write_raw(tmp_path / "a.raw", "% evt 3.0\n% geometry 346x260\n% end\n", evt3(events))
    assert_refused(path, "346x260", "640x480", calibration=calib)


def test_files_have_no_topics(tmp_path, events):
    path = write_raw(tmp_path / "a.raw", "% evt 3.0\n% end\n", evt3(events))
    assert_refused(path, "no topics", topic="/events")


@pytest.mark.parametrize("path", [".", "/"])
def test_a_folder_that_is_no_recording_is_refused(tmp_path, monkeypatch, path):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError):
        open_recording(Path(path))
