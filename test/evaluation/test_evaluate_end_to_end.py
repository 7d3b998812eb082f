"""The executable on a simulated recording, with the real estimator."""

import json
from itertools import count

import numpy as np
import pytest

from emoflow_ros.evaluation.estimates_file import EstimatesWriter, read_estimates


def test_bag_to_report(call, capsys, tmp_path, calm_bag):
    out = tmp_path / "out"
    truth = ("--gt", calm_bag.truth, calm_bag.flow)
    assert call(calm_bag.data, *truth, "--out", out, "--save-flow") == 0
    report = json.loads((out / "report.json").read_text())
    assert report["windows_ok"] == 4
    assert report["topic"] == "/davis/left/events"
    epe, share = (report["summary"][key]["value"] for key in ("epe_px", "epe_percent"))
    assert epe < 1.5
    assert share < 25
    figures = {key: entry["value"] for key, entry in report["summary"].items()}
    assert figures["rpe_step_deg"] < 1
    assert 0 < figures["oracle_ate_m"] < 0.05
    assert 0 < figures["sim3_ate_m"] <= figures["oracle_ate_m"] + 0.01
    assert 0 < figures["way_m"] < 0.3  # 0.4 m/s
    assert report["wall_s"] > 0
    assert report["worst_windows"][0] in range(4)
    assert str(out / "report.html") in capsys.readouterr().out
    assert (out / "report.html").stat().st_size > 100_000
    page = (out / "report.html").read_text()
    assert "integrated up to scale, and aligned with the truth" in page
    assert not (out / "checkpoint.pickle").exists()
    estimates = read_estimates(out / "estimates.h5")
    assert estimates.flow(0).shape == (260, 346, 2)
    assert estimates.configuration["window.duration_ms"] == 135.0


@pytest.mark.usefixtures("without_page")
def test_killed_run_is_continued_exactly(monkeypatch, call, tmp_path, calm_bag):
    """The real estimator's memory survives the checkpoint: bitwise the same estimates."""
    options = (calm_bag.data, "--window-ms", 60, "--stride-ms", 30, "--tracks", 20)
    assert call(*options, "--out", tmp_path / "whole") == 0
    monkeypatch.setattr("emoflow_ros.evaluation.run_progress.PERIOD_S", 0.0)

    calls = count(1)

    def interrupted(writer, *values, append=EstimatesWriter.append):
        if next(calls) == 7:
            raise KeyboardInterrupt
        append(writer, *values)

    with monkeypatch.context() as patched:
        patched.setattr(EstimatesWriter, "append", interrupted)
        assert call(*options, "--out", tmp_path / "parts") == 130
    assert len(read_estimates(tmp_path / "parts" / "estimates.h5")) == 6
    assert call(*options, "--out", tmp_path / "parts", "--resume") == 0

    whole, parts = (
        read_estimates(tmp_path / name / "estimates.h5").columns for name in ("whole", "parts")
    )
    assert len(whole["t"]) == 12
    for name in ("t_start_ns", "angular", "linear", "covariance", "tracks", "track_id"):
        np.testing.assert_array_equal(parts[name], whole[name])


def test_tracks_follow_the_true_displacement(call, tmp_path, calm_bag):
    """Points that are carried through four windows, against the truth carried the same way."""
    out = tmp_path / "out"
    truth = ("--gt", calm_bag.truth, calm_bag.flow)
    cut = ("--window-ms", 90, "--stride-ms", 90, "--set", "window.max_displacement_px=0")
    assert call(calm_bag.data, *truth, *cut, "--tracks", 60, "--out", out) == 0
    report = json.loads((out / "report.json").read_text())
    last = [w for w in report["windows"] if w["compared_tracks"]][-1]
    assert last["compared_tracks"] > 45
    assert 0.15 < last["track_age_s"] <= 0.36
    assert last["track_true_px"] > 8
    assert last["track_error_px"] < 0.25 * last["track_true_px"]
    assert 'id="tracks"' in (out / "report.html").read_text()
    columns = read_estimates(out / "estimates.h5").columns
    tracks, ids = columns["tracks"], columns["track_id"]
    assert tracks.shape == (4, 9, 60, 2)
    for k in range(3):  # from window to window without a jump
        same = ids[k] == ids[k + 1]
        assert same.sum() > 45
        np.testing.assert_array_equal(tracks[k + 1, 0, same], tracks[k, -1, same])
    np.testing.assert_array_equal(columns["track_times_ns"][:, -1], columns["t_end_ns"])


@pytest.mark.usefixtures("without_page")
def test_first_windows_alone(call, tmp_path, calm_bag):
    out = tmp_path / "out"
    assert call(calm_bag.data, "--max-windows", 2, "--out", out) == 0
    assert json.loads((out / "report.json").read_text())["windows_total"] == 2
    assert len(read_estimates(out / "estimates.h5")) == 2


def test_too_long_a_window(call, capsys, tmp_path, calm_bag):
    code = call(calm_bag.data, "--window-ms", 500, "--out", tmp_path / "out")
    assert code == 2
    error = capsys.readouterr().err
    assert "less than one window; give a shorter one with --window-ms" in error


@pytest.mark.usefixtures("without_page")
def test_mvsec_protocol_on_the_truths_stamps(call, tmp_path, calm_bag):
    out = tmp_path / "out"
    arguments = ("--gt", calm_bag.truth, calm_bag.flow, "--protocol", "mvsec-dt1", "--out", out)
    assert call(calm_bag.data, *arguments) == 0
    report = json.loads((out / "report.json").read_text())
    assert "mvsec-dt1: from every ground-truth stamp" in report["protocol"]
    lengths = {round(w["t_end_s"] - w["t_start_s"], 6) for w in report["windows"]}
    assert lengths == {0.05}
    assert report["windows_total"] == 7
