"""The real-time benchmarks: what they report is what they ran, and figures by hand."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import growth, realtime
from benchmarks._event_loop import scaled_camera
from benchmarks._scoring import Score, normalised_errors, summarise
from benchmarks.paper import Timing, compare_with_target
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.evaluation.metrics import FlowErrors
from emoflow_ros.evaluation.window_results import WindowResult
from emoflow_ros.truth import TrueTwist

MS = 1_000_000
NAN = float("nan")


def result(angular=(0, 0, 0), linear=(0, 0, 1), true_angular=(0, 0, 0), true_linear=(0, 0, 1)):
    return WindowResult(
        index=0,
        t_start=0,
        t_end=90 * MS,
        events=40_000,
        status=Status.OK,
        model=MotionModel.FULL,
        linear=np.array(linear, float),
        angular=np.array(angular, float),
        sigma=np.ones(6),
        truth=TrueTwist(np.array(true_angular, float), np.array(true_linear, float)),
        flow=None,
        quality=Quality(events=30_000, warm=True),
    )


def score(seconds: float, epe: float | None = None) -> Score:
    flow = FlowErrors(epe, 0, 0, 0, 0, 5.0, 1000) if epe is not None else None
    turning = result(true_angular=(0, 0.1, 0))
    return Score(replace(turning, flow=flow), seconds, seconds / 10, NAN, 1.0, NAN)


def strict(path: Path) -> Any:
    """Parse JSON without its extension of NaN and infinities."""
    return json.loads(path.read_text(), parse_constant=pytest.fail)


def test_normalised_errors_count_covariances():
    covariance = np.diag([0.01, 0.01, 0.0, 0.04, 0.04, 0.04])
    estimate = Estimate(0, 90 * MS, 45 * MS, Status.OK, Quality(0), covariance=covariance)
    tilted = (np.sin(0.3), 0, np.cos(0.3))
    errors = normalised_errors(estimate, result((0.2, 0.4, 0), true_linear=tilted))
    assert errors == pytest.approx(((1 + 4) / 3, 9 / 2))


def test_normalised_error_of_v_grows_up_to_the_opposite_direction():
    covariance = np.diag([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    estimate = Estimate(0, 90 * MS, 45 * MS, Status.OK, Quality(0), covariance=covariance)
    nearly = (np.sin(3.0), 0, np.cos(3.0))
    assert normalised_errors(estimate, result(true_linear=nearly))[1] == pytest.approx(4.5)


def test_no_true_direction_no_error_of_v():
    estimate = Estimate(0, 1, 0, Status.OK, Quality(0), covariance=np.eye(6))
    nees_w, nees_v = normalised_errors(estimate, result(angular=(0.3, 0, 0), true_linear=(0, 0, 0)))
    assert nees_w == pytest.approx(0.03)
    assert np.isnan(nees_v)


def test_an_error_of_exactly_zero_has_no_nees():
    estimate = Estimate(0, 1, 0, Status.OK, Quality(0), covariance=np.eye(6))
    assert np.isnan(normalised_errors(estimate, result())[0])


def test_a_scene_is_summed_up_over_seeds_and_by_the_worst():
    summary = summarise("calm", {0: [score(0.010, 0.5), score(0.020, 0.7)], 5: [score(0.060, 1.8)]})
    assert summary["all"]["warm_ms"] == pytest.approx(20)
    assert summary["worst_seed"]["warm_ms"] == pytest.approx(60)
    assert summary["all"]["flow_ms"] == pytest.approx(2)
    assert summary["all"]["epe_px"] == pytest.approx(1.0)
    assert summary["worst_seed"]["epe_px"] == pytest.approx(1.8)
    assert summary["seeds"][0]["epe_px"] == pytest.approx(0.6)
    assert summary["all"]["cold_ms"] is None
    assert summary["all"]["models"] == {"full": 3}
    assert summary["targets"]["epe_px"] == 0.7


def test_a_seed_without_a_figure_leaves_the_worst_unknown():
    summary = summarise("calm", {0: [score(0.01, 0.5)], 1: [score(0.01)]})
    assert summary["all"]["epe_px"] == 0.5
    assert summary["worst_seed"]["epe_px"] is None


def test_rms_of_w_is_over_windows_and_axes():
    off = replace(score(0.01), result=result(np.radians([3, 0, 0]), true_angular=(0, 0, 0)))
    right = replace(score(0.01), result=result(np.radians([0, 8, 0]), true_angular=(0, 0, 0)))
    moving = replace(
        right, result=result(np.radians([0, 20, 0]), true_angular=np.radians([0, 20, 0]))
    )
    figures = summarise("agile", {0: [off, moving]})["all"]
    assert figures["w_rms_deg_s"] == pytest.approx(np.sqrt(9 / 6))
    assert figures["w_rms_percent"] == pytest.approx(100 * np.sqrt(9 / 6) / 10)


def test_realtime_reports_what_it_ran(tmp_path, monkeypatch, capsys):
    recordings, runs = [], []

    def record(*args, **options):
        recordings.append(realtime_record(*args, **options))
        return recordings[-1]

    def timed(estimator, window):
        runs.append(realtime_timed(estimator, window))
        return runs[-1]

    realtime_record, realtime_timed = realtime.record, realtime.timed
    monkeypatch.setattr(realtime, "record", record)
    monkeypatch.setattr(realtime, "timed", timed)
    monkeypatch.setattr(realtime, "time_paper_loop", lambda *_: Timing(0.5, 1.0))
    out = tmp_path / "folder" / "realtime.json"
    options = "--scenes forward --seeds 4 --windows-per-seed 6 --cold-every 6 --out"
    monkeypatch.setattr("sys.argv", ["realtime.py", *options.split(), str(out)])
    assert realtime.main() == 0

    report = strict(out)
    figures = report["scenes"]["forward"]["seeds"]["4"]
    [(recording, windows)] = recordings
    *found, cold = runs
    warm_s = float(np.median([run.seconds for run in found[1:]]))
    assert (recording.scene, recording.seed, len(windows)) == ("forward", 4, 6)
    assert [w.t_end - w.t_start for w in windows] == [135 * MS] * 6
    assert figures["windows"] == 6
    assert figures["warm_ms"] == pytest.approx(1e3 * warm_s)
    assert figures["cold_ms"] == pytest.approx(1e3 * cold.seconds)
    assert figures["flow_ms"] == pytest.approx(1e3 * np.median([r.flow_seconds for r in found]))
    epe, errors, angles = [], [], []
    for whole, (estimate, *_) in zip(windows, found, strict=True):
        window = whole.since(estimate.t_start)  # the part that the motion allows
        span = window.t_start, window.t_end
        flow = estimate.flow.displacement(*span) - recording.truth.displacement(*span)
        pixels = np.unique(window.events.y.astype(int) * 346 + window.events.x)
        epe.append(np.linalg.norm(flow.reshape(-1, 2)[pixels], axis=1).mean())
        linear, angular = recording.truth.twist(estimate.t)
        errors.append(np.degrees(estimate.angular - angular))
        if estimate.translation_observable:
            cosine = estimate.linear @ linear / np.linalg.norm(linear)
            angles.append(np.degrees(np.arccos(cosine)))
    assert angles
    assert figures["epe_px"] == pytest.approx(np.mean(epe), rel=1e-4)
    assert figures["w_rms_deg_s"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    assert figures["v_error_deg"] == pytest.approx(np.median(angles), rel=1e-4)
    assert report["paper"]["full"]["seconds"] == pytest.approx(200 * 0.5 + 800 * 1.0)
    assert report["paper"]["early_stopping"]["seconds"] == pytest.approx(200 * 0.5 + 258 * 1.0)
    assert report["paper"]["full"]["over_warm_window"] == pytest.approx(900 / warm_s)
    assert report["configuration"]["window.duration_ms"] == 135
    assert report["machine"]["cores"]
    printed = capsys.readouterr().out
    assert "12.00" in printed
    assert {row["figure"] for row in report["rows"]} >= {"forward: flow image alone, median, ms"}
    assert "a check, not a result" in printed
    assert "iterations x measured" in printed


def test_growth_reports_what_it_ran(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(growth, "EVENTS", (6000, 9000))
    monkeypatch.setattr(growth, "SIZES", ((160, 120), (212, 160)))
    monkeypatch.setattr(growth, "EVENTS_PER_SIZE", 4000)
    out = tmp_path / "growth.json"
    monkeypatch.setattr("sys.argv", ["growth.py", "--windows", "2", "--out", str(out)])
    assert growth.main() == 0

    report = strict(out)
    by_events, by_pixels = report["by_events"], report["by_pixels"]
    assert [p["events"] for p in by_events + by_pixels] == [6000, 9000, 4000, 4000]
    assert [p["pixels"] for p in by_pixels] == [160 * 120, 212 * 160]
    # 26 px apart: 14 x 11 nodes on 346x260, each with two times and two components.
    assert [p["unknowns"] for p in by_events] == [14 * 11 * 4] * 2
    assert all(p["warm_windows"] == 1 and p["warm_ms"] > 0 for p in by_events + by_pixels)
    a, b = (p["warm_ms"] for p in by_events)
    assert report["lines"]["events"]["slope_ms"] == pytest.approx((b - a) / 3000)
    assert [(row["at_most"], row["verdict"]) for row in report["rows"]] == [(10, "met")] * 2
    printed = [line for line in capsys.readouterr().out.splitlines() if "furthest" in line]
    assert [line.split()[-1] for line in printed] == ["met"] * 2  # two points
    assert out.with_suffix(".png").read_bytes().startswith(b"\x89PNG")


def test_a_line_and_how_far_measurements_are_off():
    line = growth.Line.through([1, 2, 3, 4], [3.0, 5.0, 7.0, 9.0])
    assert (line.slope_ms, line.intercept_ms, line.r_squared) == pytest.approx((2, 1, 1))
    assert line.largest_deviation_percent == pytest.approx(0, abs=1e-9)
    bent = growth.Line.through([0, 1, 2], [1.0, 0.5, 3.0])
    assert (bent.slope_ms, bent.intercept_ms) == pytest.approx((1, 0.5))
    assert bent.largest_deviation_percent == pytest.approx(200)


def test_what_bends_misses_its_target():
    straight = growth.Line(1e-4, 5.0, 0.999, 9.96)
    bent = growth.Line(1e-4, 5.0, 0.999, 10.4)
    verdicts = [growth.table("events", [], line).split()[-3:] for line in (straight, bent)]
    assert verdicts == [["10", "9.96", "met"], ["10", "10.4", "missed"]]


def test_loop_on_a_gpu_is_held_against_its_target():
    """A fifth of the iterations with the contrast alone."""
    found = compare_with_target(vars(Timing(1e-3, 2e-3)))
    assert found["result"] == pytest.approx(1.8e-3)
    assert found["seconds_per_iteration"] == pytest.approx(1.95e-3)
    assert found["verdict"] == "met"
    assert compare_with_target(vars(Timing(1e-3, 2.5e-3)))["verdict"] == "missed"


def test_thinned_windows_keep_the_number_and_the_span():
    times = np.arange(10, dtype=np.int64)
    events = Events(times.astype(np.uint16), times.astype(np.uint16), times, times > 4)
    thin = growth.thinned(Window(0, 10, events), 5)
    assert thin.events.t.tolist() == [0, 2, 4, 6, 8]
    assert (thin.t_start, thin.t_end) == (0, 10)
    with pytest.raises(ValueError, match="10 events, 11 are needed"):
        growth.thinned(Window(0, 10, events), 11)


def test_a_scaled_camera_sees_as_much():
    camera = scaled_camera(1280, 720)
    assert camera.fx / camera.width == pytest.approx(226.38018519795807 / 346)
    assert camera.fx == camera.fy
    assert (camera.cx, camera.cy) == (639.5, 359.5)
