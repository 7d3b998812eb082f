"""HDF5 files with columns, in the layouts of public data sets, and the unit of their times."""

from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest
from event_bags import assert_equal

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording

N = 5000
STEP_US = 37


@pytest.fixture
def events() -> Events:
    """5000 events in 185 ms from 250 ms on, on 1280x720 pixels; times in whole microseconds."""
    k = np.arange(N)
    x, y = (k * 7 % 1280).astype(np.uint16), (k * 3 % 720).astype(np.uint16)
    return Events(x, y, (250_000 + k * STEP_US) * 1000, k % 3 == 0)


def write(path: Path, events: Events, group: str, t, names="xytp", **more) -> Path:
    """Columns in a group, compressed with Blosc; `more` are further data sets by path."""
    values = (events.x, events.y, t, events.p.astype(np.uint8))
    with h5py.File(path, "a") as file:
        place = file.require_group(group)
        for name, column in zip(names, values, strict=True):
            stored = {"chunks": (99,), **hdf5plugin.Blosc()} if len(column) else {}
            place.create_dataset(name, data=column, **stored)
        for name, value in more.items():
            file[name] = value
    return path


def index_of(t_us: np.ndarray) -> np.ndarray:
    """For every millisecond from 0 on the first event at or after it."""
    return np.searchsorted(t_us, np.arange(0, t_us[-1] + 1000, 1000))


def read_all(path: Path, since: int | None = None, **options) -> Events:
    with open_recording(path, **options) as recording:
        return Events.concatenate(list(recording.event_chunks(since)))


@pytest.mark.parametrize(
    ("group", "index"),
    [("/", "ms_to_idx"), ("events", "ms_to_idx"), ("events", None), ("a/b/c", "a/b/c/ms_map_idx")],
    ids=["EDS", "TUM-VIE", "VECtor", "nested"],
)
def test_layouts(tmp_path, events, group, index):
    t = events.t // 1000
    more = {index: index_of(t)} if index else {}
    path = write(tmp_path / "a.h5", events, group, t, **more)
    assert_equal(read_all(path), events)
    with open_recording(path) as recording:
        assert (recording.topic, recording.size, recording.camera) == (group, (0, 0), None)
        assert recording.duration == pytest.approx((N - 1) * STEP_US * 1e-6)


def test_m3ed_with_two_cameras_and_its_calibration(tmp_path, events):
    path = tmp_path / "car_data.h5"
    for side, part in (("left", events), ("right", events[:100])):
        group, t = f"prophesee/{side}", part.t // 1000
        more = {
            f"{group}/ms_map_idx": index_of(t),
            f"{group}/calib/intrinsics": [1034.5, 1033.5, 629.5, 357.5],
            f"{group}/calib/distortion_coeffs": [0.05, -0.08, 0.001, 0.002],
            f"{group}/calib/distortion_model": "radtan",
            f"{group}/calib/resolution": [1280, 720],
        }
        write(path, part, group, t[: len(part)], **more)
    assert_equal(read_all(path), events)
    assert_equal(read_all(path, topic="prophesee/right"), events[:100])
    with open_recording(path) as recording:
        assert recording.topic == "prophesee/left"
        camera = recording.camera
    assert (camera.size, camera.model) == ((1280, 720), "plumb_bob")
    assert (camera.fx, camera.cy) == (1034.5, 357.5)
    assert camera.distortion == (0.05, -0.08, 0.001, 0.002)
    with pytest.raises(InputError, match="no event columns in 'cam0'; give one of prophesee/left"):
        read_all(path, topic="cam0")


def test_unknown_lens_is_no_calibration(tmp_path, events):
    more = {
        "e/calib/intrinsics": np.ones(4),
        "e/calib/distortion_coeffs": np.ones(4),
        "e/calib/distortion_model": "omni",
        "e/calib/resolution": [1280, 720],
    }
    path = write(tmp_path / "a.h5", events, "e", events.t // 1000, **more)
    with open_recording(path) as recording:
        assert recording.camera is None
        assert recording.size == (1280, 720)


def test_several_groups_need_a_choice(tmp_path, events):
    path = tmp_path / "a.h5"
    for name in ("cam1", "cam2"):
        write(path, events, name, events.t // 1000)
    with pytest.raises(InputError, match="2 groups of events: cam1, cam2; choose with --topic"):
        read_all(path)
    assert len(read_all(path, topic="cam2")) == N


def test_other_names_signs_and_an_offset(tmp_path, events):
    """As event_utils writes them; and t_offset, which DSEC and VECtor have."""
    path = tmp_path / "a.h5"
    write(path, events, "events", events.t / 1e9, ("xs", "ys", "ts", "ps"))
    with h5py.File(path, "a") as file:
        p = np.where(events.p, 1, -1)
        del file["events/ps"]
        file["events/ps"] = p
    assert_equal(read_all(path), events)
    path = write(
        tmp_path / "b.h5",
        events,
        "events",
        (events.t // 1000).astype(np.uint32),
        t_offset=5_000_000,
    )
    assert_equal(read_all(path), Events(events.x, events.y, events.t + 5 * 10**9, events.p))


def test_since_enters_in_the_middle(tmp_path, events, monkeypatch):
    path = write(tmp_path / "a.h5", events, "/", events.t // 1000)
    monkeypatch.setattr("emoflow_ros.readers.hdf5_columns.CHUNK", 700)
    since = int(events.t[4321])
    assert_equal(read_all(path, since), events[4321:])
    assert_equal(read_all(path), events)


def test_what_cannot_be_read(tmp_path, events):
    t = events.t // 1000
    path = write(tmp_path / "a.h5", events, "e", t[:-1])
    with pytest.raises(InputError, match="different lengths"):
        read_all(path)
    path = write(tmp_path / "b.h5", events, "e", np.where(np.arange(N) == 2500, np.nan, t / 1e6))
    with pytest.raises(InputError, match="not finite"):
        read_all(path)
    path = write(tmp_path / "c.h5", events[:0], "e", t[:0])
    with pytest.raises(InputError, match="holds no events"):
        read_all(path)
    with h5py.File(tmp_path / "d.h5", "w") as file:
        file["x"] = file["y"] = np.zeros(3)
    with pytest.raises(InputError, match=r"without columns of events; it holds x \(3,\), y \(3,\)"):
        read_all(tmp_path / "d.h5")


def test_names_that_are_no_text_are_passed_over(tmp_path, events):
    path = write(tmp_path / "a.h5", events, "events", events.t // 1000)
    with h5py.File(path, "a") as file:
        file.create_group(b"ev\xffnts")
        for name in ("x", "y", "t", "p"):
            file[b"ev\xffnts/" + name.encode()] = file[f"events/{name}"][:]
    assert_equal(read_all(path), events)
    damaged = tmp_path / "b.h5"
    damaged.write_bytes(path.read_bytes().replace(b"events\0", b"\xffvents\0"))
    with pytest.raises(InputError, match=r"b\.h5: "):
        read_all(damaged)
