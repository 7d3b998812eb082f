"""DSEC's folders and lists of intervals, and a sequence through the executable."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
from synthetic import Plane, write_dsec

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, WindowPolicy
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.estimates_file import read_estimates
from emoflow_ros.evaluation.protocols import make_plan
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import Truth, load_truth
from emoflow_ros.truth.dsec_flow import DsecInterval, read_flow_png, read_test_intervals

START = 7 * NS_PER_S
RECTIFIED = Camera(640, 480, 569.76, 569.76, 335.1, 221.24)
WORLD = Plane(
    RECTIFIED,
    START,
    START + 330 * NS_PER_MS,
    np.array([0.1, -0.25, 0.1]),
    np.array([0.2, 0.1, -0.1]),
    dots=16000,
)
INTERVALS = [
    (START + 10 * NS_PER_MS, START + 110 * NS_PER_MS),
    (START + 110 * NS_PER_MS, START + 210 * NS_PER_MS),
    (START + 210 * NS_PER_MS, START + 310 * NS_PER_MS),
]


@pytest.fixture(scope="module")
def dsec(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dsec") / "zurich_city_12_a"
    return write_dsec(folder, WORLD, INTERVALS, (820, 830, 840))


def copy_of(dsec, folder: Path, *without: str) -> Path:
    """The sequence's folder again, by links, without some of its files."""
    path = folder / dsec.path.name
    for file in dsec.path.rglob("*.*"):
        part = file.relative_to(dsec.path)
        if file.is_file() and part.as_posix() not in without:
            (path / part).parent.mkdir(parents=True, exist_ok=True)
            (path / part).symlink_to(file)
    return path


class TestFolder:
    @pytest.mark.parametrize(
        "part",
        ["events/left/events.h5", "events/left/rectify_map.h5", "calibration/cam_to_cam.yaml"],
    )
    def test_names_the_part_that_misses(self, dsec, tmp_path, part):
        path = copy_of(dsec, tmp_path, part)
        with pytest.raises(InputError, match=rf"zurich_city_12_a: a DSEC sequence without {part}"):
            open_recording(path)

    def test_an_empty_folder_of_that_name(self, tmp_path):
        (tmp_path / "thun_00_a").mkdir()
        with pytest.raises(InputError, match=r"without events/left/events\.h5; unpack"):
            open_recording(tmp_path / "thun_00_a")

    def test_archives_of_one_sequence(self, dsec, tmp_path):
        """As the download page names them."""
        path = tmp_path / "zurich_city_12_a"
        for part, name in {
            "events/left": "zurich_city_12_a_events_left",
            "calibration": "zurich_city_12_a_calibration",
            "flow/forward": "zurich_city_12_a_optical_flow_forward_event",
            "flow/forward_timestamps.txt": "zurich_city_12_a_optical_flow_forward_timestamps.txt",
        }.items():
            path.mkdir(exist_ok=True)
            (path / name).symlink_to(dsec.path / part)
        with open_recording(path) as recording:
            assert recording.camera == RECTIFIED
            flows = load_truth(recording).flows
        assert flows.intervals[2] == DsecInterval(*INTERVALS[2], 840)

    def test_flow_truth_from_another_folder(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path, "flow/forward_timestamps.txt")
        for image in path.glob("flow/forward/*.png"):
            image.unlink()
        (path / "flow" / "forward").rmdir()
        with open_recording(path) as recording:
            assert load_truth(recording).flows is None
            assert len(load_truth(recording, [dsec.path]).flows.intervals) == 3

    def test_half_of_the_truth(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path, "flow/forward_timestamps.txt")
        with (
            open_recording(path) as recording,
            pytest.raises(InputError, match=r"without flow/forward_timestamps\.txt"),
        ):
            load_truth(recording)

    def test_truth_of_other_lengths(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path, "flow/forward/000840.png")
        with (
            open_recording(path) as recording,
            pytest.raises(InputError, match="2 images, but 3 intervals"),
        ):
            load_truth(recording)

    def test_calibration_without_the_rectified_view(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path, "calibration/cam_to_cam.yaml")
        (path / "calibration").mkdir()
        (path / "calibration" / "cam_to_cam.yaml").write_text("intrinsics: {cam0: {}}\n")
        with pytest.raises(InputError, match="holds no intrinsics of camRect0"):
            open_recording(path)

    def test_calibration_that_cannot_be(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path, "calibration/cam_to_cam.yaml")
        (path / "calibration").mkdir()
        file = path / "calibration" / "cam_to_cam.yaml"
        file.write_text("intrinsics: {camRect0: {camera_matrix: [0, 5, 3, 3]}}\n")
        with pytest.raises(InputError) as error:
            open_recording(path)
        assert str(error.value) == (
            f"{file}: camRect0: focal lengths fx=0.0, fy=5.0; calibrate the camera: both must be "
            "positive, or give a calibration with --calib FILE"
        )

    def test_map_of_another_size(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path, "events/left/rectify_map.h5")
        with h5py.File(path / "events" / "left" / "rectify_map.h5", "w") as file:
            file["rectify_map"] = np.zeros((10, 20, 2))
        with pytest.raises(InputError, match=r"a map of shape \(10, 20, 2\)"):
            open_recording(path)


class TestIntervals:
    def test_test_list(self, tmp_path):
        path = tmp_path / "thun_01_a.csv"
        path.write_text(
            "# from_timestamp_us, to_timestamp_us, file_index\n10, 20, 820\n50,60,830\n"
        )
        assert read_test_intervals(path) == [
            DsecInterval(10_000, 20_000, 820),
            DsecInterval(50_000, 60_000, 830),
        ]

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("", "not 3 numbers in every line"),
            ("1, 2\n", "not 3 numbers in every line"),
            ("1, 2, a\n", "not a table of whole numbers"),
            ("2, 1, 5\n", "empty or not in order"),
            ("5, 6, 1\n1, 2, 2\n", "empty or not in order"),
        ],
    )
    def test_bad_lists(self, tmp_path, text, words):
        path = tmp_path / "thun_01_a.csv"
        path.write_text(text)
        with pytest.raises(InputError, match=words):
            read_test_intervals(path)

    def test_neither_truth_nor_list(self, dsec, tmp_path):
        path = copy_of(dsec, tmp_path)
        with open_recording(path) as recording, pytest.raises(InputError, match="neither flow"):
            make_plan("dsec", recording, Truth(), WindowPolicy())

    def test_list_in_a_folder_of_lists(self, dsec, tmp_path):
        a, b = INTERVALS[1]
        (tmp_path / "zurich_city_12_a.csv").write_text(f"{a // 1000}, {b // 1000}, 7\n")
        with open_recording(dsec.path) as recording:
            plan = make_plan("dsec", recording, Truth(), WindowPolicy(), test_times=tmp_path)
        assert plan.images == (DsecInterval(a, b, 7),)
        assert "1 intervals of zurich_city_12_a.csv" in plan.description

    def test_other_recordings_are_refused(self, dsec, tmp_path):
        with (
            open_recording(dsec.path / "events" / "left" / "events.h5") as recording,
            pytest.raises(InputError, match="give the folder of a DSEC sequence"),
        ):
            make_plan("dsec", recording, Truth(), WindowPolicy())


def test_sequence_to_report_and_submission(call, capsys, tmp_path, dsec):
    """The real estimator, at the intervals of a list: its images against the exact flow."""
    lines = [f"{a // 1000}, {b // 1000}, {10 * k}" for k, (a, b) in enumerate(INTERVALS[1:])]
    (tmp_path / "list.csv").write_text("\n".join(lines))
    out, images = tmp_path / "out", tmp_path / "submission"
    options = ("--protocol", "dsec", "--submission", images, "--out", out)
    # Windows as long as the intervals, so that the stored flow is that of the intervals.
    options += ("--timestamps", tmp_path / "list.csv", "--save-flow")
    options += ("--set", "window.duration_ms=100.0")
    assert call(dsec.path, *options) == 0
    assert str(images / "zurich_city_12_a") in capsys.readouterr().out
    report = json.loads((out / "report.json").read_text())
    assert report["protocol"].startswith("dsec: 2 intervals of list.csv; policy causal")
    assert report["summary"]["epe_px"]["windows"] == 2
    assert report["summary"]["epe_px"]["value"] < 1.5
    assert report["summary"]["true_displacement_px"]["value"] > 8
    estimates = read_estimates(out / "estimates.h5")
    starts = estimates.columns["t_start_ns"].tolist()
    for k, (start, end) in enumerate(INTERVALS[1:]):
        flow, valid = read_flow_png(images / "zurich_city_12_a" / f"{10 * k:06d}.png")
        assert valid.all()
        stored = estimates.flow(starts.index(start))
        np.testing.assert_allclose(flow, stored, atol=0.02)
        error = np.linalg.norm(flow - WORLD.displacement(start, end), axis=-1)
        assert np.median(error) < 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--submission", "x"], "--submission: is for protocol dsec only"),
        (["--timestamps", "x"], "--timestamps: is for protocol dsec only"),
        (["--policy", "paper"], "--policy paper: the protocol 'windows' has no intervals"),
        (["--protocol", "dsec", "--calib", "calib.txt"], "without --calib"),
    ],
)
def test_options_that_do_not_go_together(monkeypatch, call, capsys, tmp_path, dsec, options, words):
    monkeypatch.chdir(tmp_path)
    Path("calib.yaml").touch()
    Path("calib.txt").write_text("555 555 320 240 0 0 0 0 0")
    assert call(dsec.path, "--out", "out", *options) == 2
    error = capsys.readouterr().err
    assert words in error
