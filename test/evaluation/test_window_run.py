"""The whole way from a recording to the report, with an estimator whose errors are known."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.benchmark_sequences import Published
from emoflow_ros.evaluation.estimates_file import EstimatesWriter, read_estimates
from emoflow_ros.evaluation.summary import summarise
from emoflow_ros.evaluation.window_run import evaluate
from emoflow_ros.readers import open_recording
from emoflow_ros.report.report_writer import write_report
from emoflow_ros.truth import load_truth
from emoflow_ros.truth.text_truth import ConstantRotation

OMEGA = np.array([0.3, 0.5, -0.2])
CAMERA = Camera(240, 180, 200.0, 200.0, 119.5, 89.5)


class ShiftedFlow:
    """The true flow plus a constant velocity in px/s."""

    def __init__(self, shift):
        self.true = ConstantRotation(CAMERA, OMEGA, "test")
        self.shift = np.float32(shift)

    def displacement(self, t0, t1):
        return self.true.displacement(t0, t1).displacement + self.shift * ((t1 - t0) / 1e9)

    def tracks(self, points, times):
        column, row = points.astype(int).T
        return np.stack([points + self.displacement(times[0], t)[row, column] for t in times])


class KnownErrors:
    """Returns 1.2 times the true rotation and a flow that is (3, 4) px per 100 ms off."""

    def __init__(self, camera=None, fail_at=(), interrupt_at=None):
        self.calls = self.resets = 0
        self.fail_at, self.interrupt_at = fail_at, interrupt_at

    def estimate(self, window):
        self.calls += 1
        if self.calls == self.interrupt_at:
            raise KeyboardInterrupt
        if self.calls in self.fail_at:
            raise ValueError("singular matrix")
        return Estimate(
            window.t_start,
            window.t_end,
            (window.t_start + window.t_end) // 2,
            Status.OK,
            Quality(events=len(window.events), runtime_s=0.05, contrast_gain=1.5),
            MotionModel.ROTATION,
            angular=1.2 * OMEGA,
            flow=ShiftedFlow((30.0, 40.0)),
        )

    def reset(self):
        self.resets += 1


@pytest.fixture
def folder(tmp_path):
    return spin(tmp_path)


def spin(parent):
    """Write an ECD folder of 550 ms with motion.txt."""
    path = parent / "spin"
    path.mkdir()
    rng = np.random.default_rng(0)
    n = 5501
    x, y = rng.integers(0, 240, n), rng.integers(0, 180, n)
    rows = np.column_stack([2 + np.arange(n) * 1e-4, x, y, np.arange(n) % 2])
    np.savetxt(path / "events.txt", rows, fmt="%.6f %d %d %d")
    (path / "calib.txt").write_text("200 200 119.5 89.5 0 0 0 0 0")
    (path / "motion.txt").write_text(" ".join(map(str, OMEGA)))
    return path


def run(path, estimator=None, window_ms=100.0, stride_ms=0.0, **options):
    with open_recording(path) as recording:
        return evaluate(
            recording,
            estimator or KnownErrors(),
            WindowSlicer(WindowPolicy(duration_ms=window_ms, stride_ms=stride_ms)),
            load_truth(recording),
            **options,
        )


def test_windows_and_their_errors(folder):
    windows = run(folder).windows
    assert [(w.t_start, w.t_end) for w in windows] == [
        (2_000_000_000 + k * 100_000_000, 2_100_000_000 + k * 100_000_000) for k in range(5)
    ]
    for w in windows:
        assert w.events == 1000
        assert w.flow.epe_px == pytest.approx(5.0, abs=1e-5)
        assert w.flow.pe3 == 100.0
        assert w.axis_error_deg == pytest.approx(0.0, abs=1e-6)
        assert w.rate_ratio == pytest.approx(1.2)
        np.testing.assert_allclose(w.angular_error, 0.2 * OMEGA)
        assert np.isnan(w.direction_error_deg)


def test_last_incomplete_window_is_left_out_and_a_just_complete_one_is_not(folder):
    assert len(run(folder, window_ms=110.0).windows) == 5
    assert len(run(folder, window_ms=549.0).windows) == 1
    with pytest.raises(InputError, match=r"span 550.0 ms, less than one window.*--window-ms"):
        run(folder, window_ms=551.0)


def test_summary(folder):
    measures = {m.key: m for m in summarise(run(folder).windows)}
    assert measures["epe_px"].value == pytest.approx(5.0, abs=1e-5)
    assert measures["epe_px"].windows == 5
    rms = np.degrees(np.sqrt(np.mean((0.2 * OMEGA) ** 2)))
    assert measures["angular_rms_deg_s"].value == pytest.approx(rms)
    assert measures["rate_ratio"].value == pytest.approx(1.2)
    assert measures["real_time_factor"].value == pytest.approx(2.0)  # 500 ms in 5 times 50 ms
    assert measures["runtime_p95_ms"].value == pytest.approx(50.0)
    assert "direction_error_deg" not in measures  # nothing to say about translation


def test_failed_window_is_recorded_and_the_next_one_starts_cold(folder):
    estimator = KnownErrors(fail_at=(2,))
    done = run(folder, estimator)
    assert [w.status for w in done.windows] == ["ok", "diverged", "ok", "ok", "ok"]
    assert done.windows[1].note.startswith("ValueError: singular matrix; traceback in ")
    assert np.isnan(done.windows[1].angular).all()
    assert estimator.resets == 1
    assert not done.interrupted


def test_interrupt_keeps_what_is_done(folder, tmp_path):
    with EstimatesWriter(tmp_path / "e.h5", camera=CAMERA, source="", configuration={}) as writer:
        done = run(folder, KnownErrors(interrupt_at=3), writer=writer)
    assert done.interrupted
    assert len(done.windows) == 2
    assert len(read_estimates(tmp_path / "e.h5")) == 2


def test_interrupt_in_the_middle_of_a_row_leaves_no_part_of_it(folder, tmp_path):
    class Interrupted(EstimatesWriter):
        rows = 0

        def append(self, estimate, window_events, tracks=None):
            super().append(estimate, window_events, tracks)
            self.rows += 1
            if self.rows == 3:
                raise KeyboardInterrupt

    with Interrupted(tmp_path / "e.h5", camera=CAMERA, source="", configuration={}) as writer:
        done = run(folder, writer=writer)
    assert done.interrupted
    assert len(done.windows) == len(read_estimates(tmp_path / "e.h5")) == 2


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The report of a run whose second window failed."""
    out = tmp_path_factory.mktemp("written")
    done = run(spin(out), KnownErrors(fail_at=(2,)))
    done.published = Published({"epe_px": 1.56}, ("From cold starts.",), {"epe_px": 1.61})
    return write_report(done, {"window.duration_ms": 100.0}, out)


def test_report_holds_the_values(written):
    report = json.loads(written.json.read_text())
    assert [m.key for m in written.measures] == list(report["summary"])
    assert report["summary"]["epe_px"]["value"] == pytest.approx(5.0, abs=1e-5)
    assert report["summary"]["epe_px"]["unit"] == "px"
    assert report["configuration"] == {"window.duration_ms": 100.0}
    assert (report["windows_total"], report["windows_ok"]) == (5, 4)
    assert report["windows"][0]["angular_y_rad_s"] == pytest.approx(0.6)
    assert report["windows"][0]["linear_x"] is None
    assert report["windows"][1]["note"].startswith("ValueError: singular matrix; traceback")
    assert "numpy" in report["versions"]
    assert report["truth"] == [
        "velocity and flow: motion.txt, constant rotation about the camera's centre"
    ]

    with (written.json.parent / "windows.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["status"] for row in rows] == ["ok", "diverged", "ok", "ok", "ok"]
    assert float(rows[0]["epe_px"]) == pytest.approx(5.0, abs=1e-5)

    html = written.html.read_text()
    assert 'Flow EPE</td><td class="value">5.00</td>' in html
    assert "<td>1.56</td>" in html
    assert "<td>1.61</td>" in html
    assert "<li>From cold starts.</li>" in html
    assert "4 of 5 with an estimate" in html
    assert "ValueError: singular matrix" in html
    assert "window.duration_ms" in html
    assert html.count("data:image/png;base64,") >= 1
    assert not re.search(r'(src|href)="(?!data:|#)', html), "not self-contained"


def test_report_counts_the_events_of_overlapping_windows_once(folder, tmp_path):
    """Windows of 1000 events every 500, up to 550 ms: ten of them hold the first 5500 events."""
    done = run(folder, stride_ms=50.0)
    assert sum(w.events for w in done.windows) == 10 * 1000
    written = write_report(done, {}, tmp_path)
    assert json.loads(written.json.read_text())["events"] == 5500
    assert "5 500 events" in written.html.read_text().replace("\u202f", " ")


@pytest.mark.usefixtures("without_page")
def test_every_result_holds_the_same_record_of_quality(folder, tmp_path):
    """Of an estimate from 400 of a window's latest 600 events, and of a window that failed."""

    class Thinning(KnownErrors):
        def estimate(self, window):
            whole = super().estimate(window)
            quality = Quality(400, 9, "deadline", 1.5, 0.25, 0.75, 0.05, True)
            start = window.t_start + 40_000_000
            return replace(whole, t_start=start, quality=quality, linear=np.array([0, 0, 1.0]))

    with EstimatesWriter(tmp_path / "e.h5", camera=CAMERA, source="", configuration={}) as writer:
        done = run(folder, Thinning(fail_at=(2,)), writer=writer)
    report = json.loads(write_report(done, {}, tmp_path).json.read_text())
    with (tmp_path / "windows.csv").open() as file:
        table = list(csv.DictReader(file))
    thinned = {
        "translation_observable": False,
        "window_events": 600,
        "events": 400,
        "iterations": 9,
        "stop_reason": "deadline",
        "contrast_gain": 1.5,
        "residual_px": 0.25,
        "inlier_fraction": 0.75,
        "warm": True,
        "runtime_s": 0.05,
    }
    failed = {
        "translation_observable": False,
        "window_events": 1000,
        "events": 0,
        "iterations": 0,
        "stop_reason": "diverged",
        "contrast_gain": None,
        "residual_px": None,
        "inlier_fraction": None,
        "warm": False,
        "runtime_s": 0.0,
    }
    columns = read_estimates(tmp_path / "e.h5").columns
    for i, expected in enumerate((thinned, failed, thinned)):
        assert {name: report["windows"][i][name] for name in expected} == expected
        in_table = {name: "" if value is None else str(value) for name, value in expected.items()}
        assert {name: table[i][name] for name in expected} == in_table
        for name, value in expected.items():
            np.testing.assert_equal(columns[name][i], np.nan if value is None else value)


def test_report_shows_every_truth_and_moving_objects(folder, tmp_path):
    """A gyro that says half the rate beside motion.txt, and an object in the upper half."""
    t = np.arange(1.9, 2.7, 0.001)
    readings = np.column_stack([t, np.zeros((len(t), 3)), np.tile(0.5 * OMEGA, (len(t), 1))])
    np.savetxt(folder / "imu.txt", readings)
    done = run(folder)
    static = replace(done.windows[0].flow, epe_px=2.5)
    done.windows[:] = [replace(w, static_flow=static) for w in done.windows]
    written = write_report(done, {}, tmp_path)
    report = json.loads(written.json.read_text())
    summary, by_truth = report["summary"], report["velocity_by_truth"]
    assert summary["moving_epe_px"]["value"] == pytest.approx(5.0, abs=1e-5)
    assert summary["static_epe_px"]["value"] == pytest.approx(2.5)
    assert by_truth["motion.txt"]["rate_ratio"]["value"] == pytest.approx(1.2)
    assert by_truth["imu.txt"]["rate_ratio"]["value"] == pytest.approx(2.4)
    apart = np.degrees(np.sqrt(np.mean((0.5 * OMEGA) ** 2)))
    assert by_truth["imu.txt"]["truth_distance_deg_s"]["value"] == pytest.approx(apart)
    assert report["windows"][0]["truth2_angular_y_rad_s"] == pytest.approx(0.25)
    html = written.html.read_text()
    assert "<th>motion.txt</th><th>imu.txt</th>" in html
    assert "Flow EPE there, without its pixels" in html


def test_links_of_the_report_lead_somewhere(written):
    html = written.html.read_text()
    targets = re.findall(r'href="#([^"]+)"', html)
    assert {"summary", "worst", "windows"} <= set(targets)
    assert set(targets) <= set(re.findall(r'id="([^"]+)"', html))
