"""HDF5 files with columns, in the layouts of public data sets, and the unit of their times."""

from pathlib import Path

import h5py
import hdf5plugin
import numpy as np
import pytest
from event_bags import assert_equal

from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers import open_recording
from emoflow_ros.readers.hdf5_columns import Clues, unit_ns

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
    with pytest.raises(InputError, match="not a recording of a known format"):
        read_all(tmp_path / "d.h5")


S, MS, US, NS = 10**9, 10**6, 10**3, 1
RATE = 100_000  # events/s
TIMES = np.arange(3000) / RATE + 0.25  # s


@pytest.mark.parametrize(
    ("unit", "t", "more"),
    [
        (S, TIMES, {}),
        (S, TIMES + 1.7e9, {}),
        (US, TIMES * 1e6, {}),
        (US, np.rint(TIMES * 1e6 + 1).astype(np.uint32), {}),
        (US, np.rint(TIMES * 1e6).astype(np.int64) + 1_700_000_000_000_000, {}),
        (US, TIMES * 1e6 + 1.7e15, {}),
        (NS, np.rint(TIMES * 1e9).astype(np.int64) + 1_700_000_000_000_000_000, {}),
        (NS, TIMES * 1e9 + 1.7e18, {}),
        (NS, np.rint(TIMES * 1e6).astype(np.int64) * 1000, {}),
        (NS, np.rint(np.linspace(0, 5e9 + 7, 3000)).astype(np.int64), {}),
        # Decided by the index of milliseconds, from the first event on and from zero on.
        (NS, np.rint(TIMES * 1e9).astype(np.int64) + 7, {"milliseconds": 30}),
        (US, np.rint(TIMES * 1e6).astype(np.int64) // 1000 * 1000, {"milliseconds": 280}),
        (US, np.rint(TIMES[:30] * 1e6).astype(np.int64) + 10**15, {"milliseconds": 2}),
        (S, TIMES / 100, {"milliseconds": 1}),
        # A simulator's milliseconds, in microseconds: 4e7 events per second as nanoseconds.
        (US, np.repeat(np.arange(30) * 1000, 40), {}),
        # Those of 1000 events per second, and more than an hour: 32 bits hold no nanoseconds.
        (US, (np.arange(3000) * 1000).astype(np.uint32), {}),
        (US, np.linspace(0, 4e9, 5_000_000)[::1000].astype(np.uint32), {"count": 5_000_000}),
        # Declared, against what else would count.
        (MS, TIMES * 1e3, {"attributes": {"unit": "ms"}}),
        (NS, TIMES, {"attributes": {"units": b"Nanoseconds"}}),
    ],
)
def test_unit_of_time(unit, t, more):
    count, index = more.get("count", len(t)), more.get("milliseconds", 0)
    clues = Clues(Path("a.h5"), more.get("attributes", {}), t, count, index)
    assert unit_ns(clues) == unit


def test_unit_that_nothing_decides():
    """300 events in 2e9 ticks, no thousands: half an hour, or 2 s."""
    t = np.sort(np.random.default_rng(0).integers(0, 2 * 10**9, 300))
    with pytest.raises(InputError) as error:
        unit_ns(Clues(Path("a.h5"), {}, t, 300))
    assert str(error.value).startswith("a.h5: the unit of t cannot be told: 300 events over ")
    assert "attribute 'unit': s, us or ns" in str(error.value)
    with pytest.raises(InputError, match="unknown unit 'ticks'"):
        unit_ns(Clues(Path("a.h5"), {"unit": "ticks"}, t, 300))
