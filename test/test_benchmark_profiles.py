"""The comparison of profiles: what is kept, what is done again, and the tables by hand."""

import json
import re

import pytest

from benchmarks import profiles
from benchmarks._profile_tables import Cell, Row, paired_table, table, verdicts
from emoflow_ros.config import load_config

TINY = {
    "estimator.max_events": 2000,
    "estimator.field.width": 16,
    "estimator.field.layers": 2,
    "estimator.optimizer.iterations": 12,
    "estimator.loss.contrast_only": 5,
    "estimator.early_stop.burn_in": 5,
    "estimator.min_contrast_gain": 0.0,
}
WHERE = {
    "machine": {"processor": "abacus", "cores": "1", "memory": "0 GiB"},
    "versions": {"Python": "3.12"},
}


def row(index: int, epe: float | None, **values) -> Row:
    figures = {
        "status": "ok", "model": "full", "static_epe_px": None, "out_percent": 0.0,
        "ae_deg": 1.0, "true_px": 6.0, "w_rms_deg_s": 3.0, "v_error_deg": 10.0,
        "seconds": 0.02, "cpu_seconds": 0.015, "nees_w": 1.0, "nees_v": None,
        "contrast_gain": 1.4, "events": 30_000, "iterations": 4, "stop_reason": "iterations",
    }  # fmt: skip
    return Row(index=index, epe_px=epe, **(figures | values))


def numbers(text: str, scene: str, profile: str) -> list[str]:
    """Cells of a table's line behind scene and profile."""
    (line,) = re.findall(rf"^\| {scene} \| `{profile}` \| (.*) \|$", text, re.MULTILINE)
    return line.split(" | ")


def test_figures_are_averaged_as_the_heads_say():
    rows = (
        row(0, 0.5, w_rms_deg_s=3.0, v_error_deg=2.0, static_epe_px=0.25, seconds=0.01),
        row(1, 1.0, w_rms_deg_s=4.0, v_error_deg=170.0, seconds=0.02),
        row(2, None, status="no_motion", w_rms_deg_s=None, v_error_deg=None, seconds=0.06),
    )
    text = table([Cell("realtime", "calm", 0, rows, {}, WHERE)])
    line = numbers(text, "calm", "realtime")
    assert line == ["2 of 3", "0.75", "0.25", "0.00", "1.00", "3.54", "86.00", "0.02", "0.015"]
    assert "One thread; abacus, 1 cores, 0 GiB. Python 3.12." in text


def test_pairs_are_the_same_windows():
    cells = [
        Cell("realtime", "calm", 0, (row(0, 9.0), row(1, 0.5)), {}, WHERE),
        Cell("realtime", "calm", 1, (row(0, 8.0), row(1, 0.7)), {}, WHERE),
        Cell("realtime", "agile", 0, (row(0, 7.0), row(1, 7.0)), {}, WHERE),
        Cell("rigid", "calm", 0, (row(0, 6.0), row(1, 0.4)), {}, WHERE),
        Cell("paper", "calm", 0, (row(1, 1.5),), {}, WHERE),
        Cell("paper", "calm", 1, (row(1, 1.7),), {}, WHERE),
    ]
    text = paired_table(cells)
    assert numbers(text, "calm", "paper")[:2] == ["2", "1.60"]
    assert numbers(text, "calm", "realtime")[:2] == ["2", "0.60"]
    assert "agile" not in text
    assert "`rigid`" not in text  # it lacks one of the two windows


def test_every_scene_gets_a_verdict_from_the_pairs():
    def cells(scene, fast, slow):
        other = row(0, 9.0, cpu_seconds=9.0)  # a window that the slow profile has not
        return [
            Cell("realtime", scene, 0, (other, fast), {}, WHERE),
            Cell("paper_early_stop", scene, 0, (slow,), {}, WHERE),
        ]

    slow = row(1, 0.5, w_rms_deg_s=3.0, v_error_deg=10.0, cpu_seconds=75.0)
    lost = row(1, 0.5, w_rms_deg_s=None, v_error_deg=None)
    text = verdicts(
        [
            *cells("calm", row(1, 0.5), slow),
            *cells("mover", row(1, 0.4, w_rms_deg_s=3.5, v_error_deg=65.0), slow),
            *cells("noisy", row(1, 0.6, cpu_seconds=0.02), slow),
            *cells("agile", lost, slow),
            *cells("rotation", row(1, 0.1, v_error_deg=None), row(1, 0.5, v_error_deg=None)),
        ]
    )
    found = {
        line.split(" | ")[0][2:]: line[2:-2].split(" | ")[1:] for line in text.splitlines()[4:]
    }
    assert found["calm"] == ["1", "0.50 / 0.50", "3.00 / 3.00", "10.00 / 10.00", "5000", "met"]
    assert found["mover"][-1] == "missed: w, v"
    assert found["noisy"][-2:] == ["3750", "missed: EPE, speed"]
    assert found["agile"][2:] == ["- / 3.00", "- / 10.00", "5000", "missed: w, v"]
    assert found["rotation"][3:] == ["- / -", "1", "missed: speed"]
    assert found["driving"] == ["0", "-", "-", "-", "-", "not measured"]
    nothing = verdicts(cells("calm", row(1, 0.5), slow)[:1])
    assert nothing == "Target: not measured, no window of the published loop is there.\n"
    assert "`realtime` <= `paper_early_stop` in EPE, w and v, at least 5000 times faster" in text


@pytest.fixture
def command(monkeypatch, tmp_path):
    """Run the benchmark on short recordings with a tiny network; count what is measured."""
    measured = []

    def counted(job, config, measure=profiles.measure):
        measured.append(job)
        return measure(job, config)

    def load(profile, overrides):
        return load_config(profile, overrides | (TINY if profile.startswith("paper") else {}))

    monkeypatch.setattr(profiles, "load_config", load)
    monkeypatch.setattr(profiles, "WINDOWS", 2)
    monkeypatch.setattr(profiles, "measure", counted)

    def run(*options):
        measured.clear()
        words = ("profiles.py", "--out", tmp_path, "--seeds", 3, *options)
        monkeypatch.setattr("sys.argv", [str(word) for word in words])
        assert profiles.main() == 0
        return list(measured)

    return run


def test_a_run_goes_on_where_it_was_cut(command, tmp_path, capsys):
    options = ("--profiles", "realtime", "paper", "--scenes", "mover", "--windows", 1)
    assert command(*options, "--minutes", 0) == []
    assert [job.file_name for job in command(*options)] == [
        "realtime-mover-seed3.json",
        "paper-mover-seed3-window1.json",
    ]
    assert command(*options) == []
    kept = json.loads((tmp_path / "paper-mover-seed3-window1.json").read_text())
    assert kept["configuration"]["estimator.optimizer.iterations"] == 12
    (paper,) = kept["rows"]
    assert (paper["index"], paper["iterations"], paper["events"]) == (1, 12, 2000)
    assert paper["cpu_seconds"] > 0
    assert 0 < paper["static_epe_px"] != paper["epe_px"]
    streamed = json.loads((tmp_path / "realtime-mover-seed3.json").read_text())["rows"]
    assert [r["index"] for r in streamed] == [0, 1]

    text = (tmp_path / "table.md").read_text()
    assert text in capsys.readouterr().out
    paired, _, judged = text[text.index("The windows of paper:") :].partition("Target:")
    assert judged.count("| not measured |") == 6  # all scenes but the one that was run
    assert "| mover | 1 | " in judged
    assert numbers(paired, "mover", "realtime")[1] == f"{streamed[1]['epe_px']:.2f}"

    kept["configuration"]["estimator.optimizer.iterations"] = 11
    (tmp_path / "paper-mover-seed3-window1.json").write_text(json.dumps(kept))
    assert [job.profile for job in command(*options)] == ["paper"]


def test_a_window_beyond_the_recording_is_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["profiles.py", "--windows", "18"])
    assert profiles.main() == 2
    assert "--windows: not all within 0 to 17; give such indices" in capsys.readouterr().err
