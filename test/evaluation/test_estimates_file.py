from types import SimpleNamespace

import h5py
import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import INSTANTS
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation import estimates_file
from emoflow_ros.evaluation.estimates_columns import ADDED, QUALITY
from emoflow_ros.evaluation.estimates_file import EstimatesWriter, read_estimates
from emoflow_ros.evaluation.track_errors import ComparedTracks

CAMERA = Camera(6, 4, 5.0, 5.0, 3.0, 2.0, "equidistant", (0.1, 0.2, 0.3, 0.4))
T0 = 1_744_227_144_732_712_345  # a Unix time that float64 seconds cannot hold exactly


class Flow:
    def displacement(self, t0, t1):
        rows, columns = np.mgrid[0:4, 0:6]
        return (np.stack([columns, -rows], -1) * (t1 - t0) / 90e6).astype(np.float32)


def estimate(i, status=Status.OK, model=MotionModel.FULL):
    start = T0 + i * 90_000_000
    return Estimate(
        t_start=start,
        t_end=start + 90_000_000,
        t=start + 45_000_000,
        status=status,
        quality=Quality(
            events=100 + i,
            iterations=7 + i,
            stop_reason="converged" if status is Status.OK else status,
            contrast_gain=1.5 if status is Status.OK else np.nan,
            residual_px=0.125 * i,
            inlier_fraction=0.75,
            runtime_s=0.25,
            warm=i > 0,
        ),
        model=model,
        linear=np.array([0.6, 0.0, 0.8]),
        angular=np.array([0.1, 0.2, 0.3]) * i,
        covariance=np.eye(6) * i,
        flow=Flow() if status is Status.OK else None,
    )


def write(path, save_flow):
    with EstimatesWriter(
        path,
        camera=CAMERA,
        source="a.bag",
        configuration={"window.duration_ms": 90.0},
        save_flow=save_flow,
    ) as writer:
        writer.append(estimate(0), 200)
        writer.append(estimate(1, Status.TOO_FEW_EVENTS, MotionModel.STATIC), 201)
        writer.append(estimate(2), 202)


def without_what_was_added(path):
    """Leave what files had before the record of quality was whole."""
    with h5py.File(path, "r+") as file:
        for name in ADDED:
            del file[name]


def test_round_trip(tmp_path):
    path = tmp_path / "estimates.h5"
    write(path, save_flow=True)
    read = read_estimates(path)
    columns = read.columns
    assert len(read) == 3
    assert read.camera == CAMERA
    assert read.source == "a.bag"
    assert read.configuration == {"window.duration_ms": 90.0}
    assert columns["t_start_ns"].tolist() == [T0, T0 + 90_000_000, T0 + 180_000_000]
    assert columns["t_end_ns"][0] == T0 + 90_000_000
    np.testing.assert_allclose(columns["t_end"] - columns["t_start"], 0.09, atol=1e-6)
    np.testing.assert_array_equal(columns["linear"][2], [0.6, 0, 0.8])
    np.testing.assert_allclose(columns["angular"][2], [0.2, 0.4, 0.6])
    assert np.isnan(columns["angular"][1]).all()
    np.testing.assert_array_equal(columns["covariance"][2], np.eye(6) * 2)
    assert columns["status"].tolist() == ["ok", "too_few_events", "ok"]
    assert columns["model"].tolist() == ["full", "static", "full"]
    assert read.has_flow
    assert read.flow(0).dtype == np.float16
    np.testing.assert_array_equal(read.flow(2)[3, 5], [5, -3])
    assert np.isnan(read.flow(1)).all()


def test_whole_record_of_quality_is_kept(tmp_path):
    path = tmp_path / "estimates.h5"
    write(path, save_flow=False)
    columns = read_estimates(path).columns
    assert {name: columns[name].tolist() for name in QUALITY if name != "contrast_gain"} == {
        "translation_observable": [True, False, True],
        "window_events": [200, 201, 202],
        "events": [100, 101, 102],
        "iterations": [7, 8, 9],
        "stop_reason": ["converged", "too_few_events", "converged"],
        "residual_px": [0.0, 0.125, 0.25],
        "inlier_fraction": [0.75] * 3,
        "warm": [False, True, True],
        "runtime_s": [0.25] * 3,
    }
    np.testing.assert_array_equal(columns["contrast_gain"], [1.5, np.nan, 1.5])


def test_older_file_is_read_and_not_continued(tmp_path):
    path = tmp_path / "estimates.h5"
    write(path, save_flow=False)
    without_what_was_added(path)
    columns = read_estimates(path).columns
    assert columns["events"].tolist() == [100, 101, 102]
    assert ADDED.isdisjoint(columns)
    words = r"estimates.h5: without window_events, .*warm, as of an earlier version; start"
    with pytest.raises(InputError, match=words):
        EstimatesWriter(path, camera=CAMERA, source="", configuration={}, keep=1)
    assert len(read_estimates(path)) == 3  # left as it was
    with h5py.File(path, "r+") as file:
        del file["angular"]
    with pytest.raises(InputError, match=r"cannot be read.*angular"):
        read_estimates(path)


def test_every_dataset_carries_unit_and_description(tmp_path):
    path = tmp_path / "estimates.h5"
    write(path, save_flow=True)
    with h5py.File(path) as file:
        assert file["angular"].attrs["unit"] == "rad/s"
        assert file["t_start"].attrs["unit"] == "s"
        assert file["flow"].attrs["unit"] == "px"
        assert file["flow"].shape == (3, 4, 6, 2)
        assert file["flow"].compression == "gzip"
        assert all(file[name].attrs["description"] for name in file)


def test_tracks_round_trip(tmp_path):
    path = tmp_path / "estimates.h5"
    positions = np.random.default_rng(0).uniform(0, 6, (2, INSTANTS, 3, 2))
    positions[1, 4:, 0] = np.nan
    options = {"camera": CAMERA, "source": "", "configuration": {}, "tracks": 3}
    with EstimatesWriter(path, **options) as writer:
        for i in range(2):
            times = T0 + i * 90_000_000 + np.arange(INSTANTS) * 11_250_000
            ids = np.array([0, 1, 2 + i])
            nothing = np.full((2, 3, 2), np.nan)
            writer.append(estimate(i), 200, ComparedTracks(times, positions[i], ids, nothing, None))
    columns = read_estimates(path).columns
    np.testing.assert_allclose(columns["tracks"], positions, rtol=1e-6)
    assert columns["track_id"].tolist() == [[0, 1, 2], [0, 1, 3]]
    assert columns["track_times_ns"][1, 8] == T0 + 180_000_000
    with h5py.File(path) as file:
        assert file["tracks"].attrs["unit"] == "px"
        assert all(file[name].attrs["description"] for name in file)
    with EstimatesWriter(path, **options, keep=1):
        pass
    assert read_estimates(path).columns["tracks"].shape == (1, INSTANTS, 3, 2)


def test_without_flow(tmp_path):
    path = tmp_path / "estimates.h5"
    write(path, save_flow=False)
    assert not read_estimates(path).has_flow
    assert "tracks" not in read_estimates(path).columns


def test_rows_are_on_disk_a_second_later(tmp_path, monkeypatch):
    """What was appended is on disk although the writer was never closed."""
    path, clock = tmp_path / "estimates.h5", SimpleNamespace(monotonic=lambda: now)
    monkeypatch.setattr(estimates_file, "time", clock)

    def rows():
        copy = tmp_path / "copy.h5"
        copy.write_bytes(path.read_bytes())
        return list(read_estimates(copy).columns["window_events"])

    now = 10.0
    writer = EstimatesWriter(path, camera=CAMERA, source="", configuration={})
    writer.append(estimate(0), 200)
    assert rows() == [200]
    now = 10.9
    writer.append(estimate(1), 201)
    assert rows() == [200]
    now = 11.0
    writer.append(estimate(2), 202)
    assert rows() == [200, 201, 202]
    writer.append(estimate(3), 203)
    writer.write()
    assert rows() == [200, 201, 202, 203]
    writer.append(estimate(4), 204)
    writer.truncate(2)
    writer.append(estimate(5), 205)
    writer.__exit__(None, None, None)
    assert rows() == [200, 201, 205]


class Full(SimpleNamespace):
    """A data set that takes no values."""

    def __setitem__(self, rows, values):
        raise OSError("no space left on device")


def test_rows_that_cannot_be_written_leave_those_before(tmp_path):
    path = tmp_path / "estimates.h5"
    writer = EstimatesWriter(path, camera=CAMERA, source="", configuration={})
    writer.append(estimate(0), 200)
    t = writer._datasets["t"]
    writer._datasets["t"] = Full(dtype=t.dtype, shape=t.shape, resize=t.resize)
    writer.append(estimate(1), 201)
    with pytest.raises(OSError, match="no space"):
        writer.write()
    error = ValueError("what ended the run")
    writer.__exit__(ValueError, error, None)  # and hides no other error
    found = read_estimates(path)
    assert {len(column) for column in found.columns.values()} == {1}


def test_dense_rows_do_not_pile_up(tmp_path, monkeypatch):
    monkeypatch.setattr(estimates_file, "_PERIOD_S", 1e9)
    monkeypatch.setattr(estimates_file, "_MOST_BYTES", 4000)
    path = tmp_path / "estimates.h5"
    with EstimatesWriter(path, camera=CAMERA, source="", configuration={}) as writer:
        waiting = []
        for i in range(40):
            writer.append(estimate(i), 200)
            waiting.append(len(writer._waiting))
        assert 3 < max(waiting) < 15
    assert list(read_estimates(path).columns["events"]) == [100 + i for i in range(40)]


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "other.h5"
    with pytest.raises(InputError, match="cannot be read"):
        read_estimates(path)
    with h5py.File(path, "w"):
        pass
    with pytest.raises(InputError, match="not an estimates file"):
        read_estimates(path)
    with h5py.File(path, "w") as file:
        file.attrs.update({"format": "emoflow_ros/estimates", "version": 9})
    with pytest.raises(InputError, match="version 9, known is 1"):
        read_estimates(path)


def test_folder_that_is_not_there(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        EstimatesWriter(tmp_path / "no" / "e.h5", camera=CAMERA, source="", configuration={})
