"""The executable on a simulated recording, with the real estimator."""

import json

import numpy as np
import pytest

from emoflow_ros.offline import evaluate, evaluation
from emoflow_ros.offline.estimates import read_estimates
from emoflow_ros.simulation.cameras import davis346
from emoflow_ros.simulation.recording import simulate
from emoflow_ros.simulation.writer import OutputPaths, write_recording


@pytest.fixture(scope="module")
def paths(tmp_path_factory):
    recording = simulate(
        "calm", duration_s=0.4, seed=1, camera=davis346("plumb_bob"), fps=400, start_ns=10**9
    )
    files = OutputPaths.within(tmp_path_factory.mktemp("sim"), "calm", "rosbag2")
    write_recording(recording, files, "rosbag2")
    return files


def call(monkeypatch, *arguments):
    monkeypatch.setattr("sys.argv", ["evaluate", *map(str, arguments)])
    return evaluate.main()


def test_bag_to_report(monkeypatch, capsys, tmp_path, paths):
    out = tmp_path / "out"
    truth = ("--gt", paths.truth, paths.flow)
    assert call(monkeypatch, paths.data, *truth, "--out", out, "--save-flow") == 0
    report = json.loads((out / "report.json").read_text())
    assert report["windows_ok"] == 4
    assert report["topic"] == "/davis/left/events"
    epe, share = (report["summary"][key]["value"] for key in ("epe_px", "epe_percent"))
    assert epe < 1.5
    assert share < 25
    assert str(out / "report.html") in capsys.readouterr().out
    assert (out / "report.html").stat().st_size > 100_000
    assert not (out / "checkpoint.pickle").exists()
    estimates = read_estimates(out / "estimates.h5")
    assert estimates.flow(0).shape == (260, 346, 2)
    assert estimates.configuration["window.duration_ms"] == 90.0


def test_killed_run_is_continued_exactly(monkeypatch, tmp_path, paths):
    """The real estimator's memory survives the checkpoint: bitwise the same estimates."""
    options = (paths.data, "--window-ms", 60, "--set", "window.stride_ms=30")
    assert call(monkeypatch, *options, "--out", tmp_path / "whole") == 0
    monkeypatch.setattr("emoflow_ros.offline.checkpoint._PERIOD_S", 0.0)

    def killed(progress, window, truth, writer, done=evaluation._process):
        if len(progress.windows) == 6:
            raise KeyboardInterrupt
        done(progress, window, truth, writer)

    with monkeypatch.context() as patched:
        patched.setattr(evaluation, "_process", killed)
        assert call(monkeypatch, *options, "--out", tmp_path / "parts") == 130
    assert len(read_estimates(tmp_path / "parts" / "estimates.h5")) == 6
    assert call(monkeypatch, *options, "--out", tmp_path / "parts", "--resume") == 0

    whole, parts = (
        read_estimates(tmp_path / name / "estimates.h5").columns for name in ("whole", "parts")
    )
    assert len(whole["t"]) == 12
    for name in ("t_start_ns", "angular", "linear", "covariance"):
        np.testing.assert_array_equal(parts[name], whole[name])


def test_too_long_a_window(monkeypatch, capsys, tmp_path, paths):
    code = call(monkeypatch, paths.data, "--window-ms", 500, "--out", tmp_path / "out")
    assert code == 2
    error = capsys.readouterr().err
    assert "less than one window; give a shorter one with --window-ms" in error


def test_mvsec_protocol_on_the_truths_stamps(monkeypatch, tmp_path, paths):
    out = tmp_path / "out"
    arguments = ("--gt", paths.truth, paths.flow, "--protocol", "mvsec-dt1", "--out", out)
    assert call(monkeypatch, paths.data, *arguments) == 0
    report = json.loads((out / "report.json").read_text())
    assert "mvsec-dt1: from every ground-truth stamp" in report["protocol"]
    lengths = {round(w["t_end_s"] - w["t_start_s"], 6) for w in report["windows"]}
    assert lengths == {0.05}
    assert report["windows_total"] == 7
