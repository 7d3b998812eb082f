"""Ablations: what is changed, on which windows, and what is said where nothing can be."""

import json

import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation import ablation
from emoflow_ros.evaluation.ablation import (
    ABLATIONS,
    Ablation,
    ColdStarts,
    Row,
    variants_of,
)
from emoflow_ros.report.ablation_table import table_of

TINY = (
    "estimator.max_events=2000",
    "estimator.field.width=16",
    "estimator.optimizer.iterations=60",
    "estimator.loss.contrast_only=10",
    "estimator.early_stop.burn_in=10",
    "estimator.early_stop.min_improvement=1000",
    "estimator.min_contrast_gain=0",
)


def rows_of(out):
    return json.loads((out / "report.json").read_text())["ablation"]["rows"]


@pytest.mark.parametrize(
    ("name", "profile", "supported"),
    [(n, p, n != "start") for n in ABLATIONS for p in ("paper", "paper_dsec")]
    + [(n, "realtime", n in ("losses", "huber", "start")) for n in ABLATIONS],
)
def test_variants_differ_or_there_are_none(name, profile, supported):
    config = load_config(profile)
    if not supported:
        with pytest.raises(InputError, match=f"--ablate {name}.*no such part; use --profile"):
            variants_of(name, config)
        return
    variants = variants_of(name, config)
    different = {(v.cold, *sorted(v.overrides.items())) for v in variants}
    assert len(different) == len(variants) >= 2


def test_unsupported_is_one_line_before_any_work(call, capsys, tmp_path, calm_bag):
    out = tmp_path / "out"
    assert call(calm_bag.data, "--ablate", "depth", "--out", out) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: --ablate depth: the lattice estimator of profile realtime")
    assert error.count("\n") == 1
    assert not out.exists()


def test_start_on_a_simulated_recording(call, capsys, tmp_path, calm_bag):
    out = tmp_path / "out"
    truth = ("--gt", calm_bag.truth, calm_bag.flow)
    whole_run = ("--ablate", "start", "--out", out)
    assert call(calm_bag.data, *truth, *whole_run) == 0
    warm, cold = rows_of(out)
    assert warm["name"].startswith("warm")
    assert cold["name"].startswith("cold")
    summary = json.loads((out / "report.json").read_text())["summary"]
    assert warm["epe_px"] == summary["epe_px"]["value"]  # the run itself, not run again
    assert warm["windows_ok"] == cold["windows_ok"] == 4
    assert cold["epe_px"] != warm["epe_px"]
    assert cold["epe_px"] < 1.5
    assert cold["seconds_per_window"] > 0
    assert "ablation: start" in capsys.readouterr().out
    assert "Ablation: start" in (out / "report.html").read_text()


@pytest.mark.usefixtures("without_page")
@pytest.mark.parametrize(("name", "option"), [("huber", "dec_inlier_px"), ("losses", "dec_weight")])
def test_parts_of_the_lattice_with_a_moving_object(call, tmp_path, mover_bag, name, option):
    out = tmp_path / "out"
    truth = ("--gt", mover_bag.truth, mover_bag.flow)
    whole_run = ("--ablate", name, "--out", out)
    assert call(mover_bag.data, *truth, *whole_run) == 0
    whole, without = rows_of(out)
    assert list(without["overrides"]) == [f"estimator.{option}"]
    for row in (whole, without):
        assert row["windows_ok"] == 4
        assert 0 < row["epe_px"] < 2
        assert 0 < row["angular_rms_deg_s"] < 10
    assert without["epe_px"] != whole["epe_px"]


@pytest.mark.usefixtures("without_page")
@pytest.mark.parametrize("name", ["losses", "depth", "early_stop", "huber"])
def test_tiny_network(call, tmp_path, calm_bag, name):
    """Every ablation of the paper's method runs, on one window."""
    out = tmp_path / "out"
    truth = ("--gt", calm_bag.truth, calm_bag.flow)
    options = [part for value in TINY for part in ("--set", value)]
    options += ["--max-windows", 1, "--ablate", name, "--out", out]
    assert call(calm_bag.data, *truth, "--profile", "paper", *options) == 0
    rows = rows_of(out)
    variants = variants_of(name, load_config("paper"))
    assert [row["name"] for row in rows] == [variant.name for variant in variants]
    assert all(row["windows_ok"] == 1 and row["epe_px"] > 0 for row in rows)
    assert len({row["epe_px"] for row in rows}) == len(rows)
    if name == "losses":  # without DEC nothing estimates the egomotion
        assert [row["angular_rms_deg_s"] is None for row in rows] == [False, False, True]


@pytest.mark.usefixtures("without_page")
def test_interrupted_ablation_keeps_its_rows(monkeypatch, call, capsys, tmp_path, calm_bag):
    def stopped(*arguments, done=ablation.evaluate, **options):
        run = done(*arguments, **options)
        run.interrupted = True
        return run

    monkeypatch.setattr(ablation, "evaluate", stopped)
    out = tmp_path / "out"
    options = ("--max-windows", 1, "--ablate", "start", "--out", out)
    assert call(calm_bag.data, *options) == 130
    assert [row["name"] for row in rows_of(out)] == ["warm (from the window before)"]
    assert "variants done until then" in capsys.readouterr().err


def test_cold_starts():
    class Counting:
        def __init__(self):
            self.seen = 0

        def estimate(self, window):
            self.seen += 1
            quality = Quality(events=self.seen)
            return Estimate(0, 2, 1, Status.OK, quality, MotionModel.ROTATION)

        def reset(self):
            self.seen = 0

    estimator = ColdStarts(Counting())
    assert [estimator.estimate(None).quality.events for _ in range(3)] == [1, 1, 1]


def test_table():
    rows = (
        Row("warm", {}, 4, 0.5, 1.25, 2.0, 11.04, 0.0301),
        Row("cold", {}, 4, float("nan"), None, 2.5, None, 0.5),
    )
    lines = table_of(Ablation("start", rows)).splitlines()
    heads = "ablation: start EPE px out % RMS w deg/s v deg s/window"
    assert lines[0].split() == heads.split()
    assert lines[1].split() == ["warm", "0.50", "1.25", "2.00", "11.0", "0.030"]
    dash = "\N{EN DASH}"
    assert lines[2].split() == ["cold", dash, dash, "2.50", dash, "0.500"]
    assert len(set(map(len, lines))) == 1
