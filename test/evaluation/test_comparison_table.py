"""The table of `python -m benchmarks.comparison`: a tiny stand-in for MVSEC, and a real snippet."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known import ANGULAR, LINEAR, START, Known, KnownFlow
from synthetic import Plane, flow_maps, write_flow_npz, write_mvsec_hdf5

from benchmarks.comparison import __main__ as comparison
from benchmarks.comparison.snippet import load_snippet
from benchmarks.comparison.table import SEQUENCES as COMPARED
from benchmarks.comparison.table import published
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.evaluation.benchmark_sequences import SEQUENCES

NAME = "outdoor_day2"
FRAMES = [START + (20 + 50 * k) * NS_PER_MS for k in range(10)]
STAMPS = [START + (7 + 50 * k) * NS_PER_MS for k in range(11)]
WORLD = Plane(SEQUENCES[NAME].camera, START, START + 600 * NS_PER_MS, ANGULAR, LINEAR)
SNIPPET = Path("mvsec") / "indoor_flying1_snippet"


class Off(Known):
    """An estimator whose flow is off by (3, 4) px over any interval, and not fast."""

    def estimate(self, window):
        known = super().estimate(window)
        return replace(
            known, flow=OffFlow(WORLD.camera), quality=replace(known.quality, runtime_s=0.25)
        )


class OffFlow(KnownFlow):
    def tracks(self, points: np.ndarray, times) -> np.ndarray:
        columns, rows = points.astype(int).T
        moved = WORLD.displacement(times[0], times[1])[rows, columns] + np.array([3.0, 4.0])
        return np.stack([points, points + moved])


@pytest.fixture(scope="module")
def downloaded(tmp_path_factory) -> Path:
    """A folder as if one sequence of MVSEC had been downloaded to it."""
    folder = tmp_path_factory.mktemp("mvsec")
    write_mvsec_hdf5(folder, NAME, WORLD, FRAMES, STAMPS)
    write_flow_npz(folder / f"{NAME}_gt_flow_dist.npz", STAMPS, flow_maps(WORLD, STAMPS))
    return folder


@pytest.fixture
def call(monkeypatch, tmp_path):
    """Call the command with these arguments, into tmp_path; its exit code."""
    monkeypatch.setattr(comparison, "make_estimator", lambda camera, _: Off(camera))

    def run(*arguments: object) -> int:
        words = [str(a) for a in arguments]
        monkeypatch.setattr("sys.argv", ["comparison", *words, "--out", str(tmp_path)])
        return comparison.main()

    return run


def lines(text: str) -> dict[tuple[str, str], list[str]]:
    """Cells of a table in Markdown, by sequence and method."""
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines()]
    return {(row[0], row[1]): row[2:] for row in rows if len(row) == 8}


def test_table_of_a_folder(call, downloaded, tmp_path, capsys):
    assert call(downloaded, "--profiles", "realtime") == 0
    out, err = capsys.readouterr()
    rows = lines(out)
    epe, outliers, w, v, seconds, windows = rows[NAME, "realtime"]
    # Known is off by a rate that grows with time; windows end with their interval.
    middles = [w["t_start_s"] + w["t_end_s"] for w in report(tmp_path)["windows"]]
    late = np.mean([0.5 * m - START / NS_PER_S for m in middles])
    expected = math.degrees(math.sqrt((0.1**2 + 0.05**2 + 0.2**2) / 3)) * late
    assert float(epe) == pytest.approx(5.0, abs=0.1)
    assert float(outliers) > 99 and windows == "6 of 6"
    assert float(w) == pytest.approx(expected, abs=0.1)
    assert float(v) < 0.5 and float(seconds) == 0.25
    assert rows[NAME, "E-MoFlow"] == ["3.49", "", "5.8", "", "", ""]
    assert lines((tmp_path / "table.md").read_text()) == rows
    assert "indoor_flying1: no indoor_flying1_data.hdf5 or .bag in" in err


def report(folder: Path) -> dict:
    return json.loads((folder / f"{NAME}_realtime" / "report.json").read_text())


def test_what_is_done_is_not_done_again(call, downloaded, monkeypatch, capsys):
    assert call(downloaded, "--profiles", "realtime") == 0
    first = capsys.readouterr().out
    monkeypatch.setattr(comparison, "evaluate", None)
    assert call(downloaded, "--profiles", "realtime") == 0
    assert capsys.readouterr().out == first
    with pytest.raises(TypeError):  # another configuration is another run
        call(downloaded, "--profiles", "realtime", "--set", "estimator.model=full")


def test_published_peers_stand_beside_the_sequences_that_they_have():
    rows = {row.method: row for row in published("outdoor_day1_segment")}
    assert (rows["E-RAFT"].epe_px, rows["MultiCM"].epe_px) == (0.72, 1.25)
    assert rows["E-MoFlow, early stopping"].seconds == 4.56
    assert [row.method for row in published("outdoor_day2")] == ["E-MoFlow"]
    assert published("indoor_flying1_snippet") == []


def test_empty_folder_is_refused_with_one_line(call, tmp_path, capsys):
    assert call(tmp_path) == 2
    *missing, error = capsys.readouterr().err.splitlines()
    assert len(missing) == len(COMPARED)
    assert "holds no sequence of MVSEC" in error and "indoor_flying1_data.hdf5" in error


def test_data_without_truth_are_refused(call, downloaded, tmp_path, capsys):
    shutil.copy(downloaded / f"{NAME}_data.hdf5", tmp_path)
    assert call(tmp_path) == 2
    assert f"add {NAME}_gt.hdf5" in capsys.readouterr().err.splitlines()[-1]


@pytest.fixture
def snippet(tmp_path) -> Path:
    """Three events of two pixels, at 1, 3 and 2 m; the motion changes between its two parts."""
    (tmp_path / "events.txt").write_text("1.00 10 20 1\n1.01 10 20 0\n1.02 30 40 1\n")
    (tmp_path / "depth.txt").write_text("1\n3\n2\n")
    (tmp_path / "velocity_truth.txt").write_text(
        "0.9 1.1 0 0.2 0 0.4 0 0\n1.1 1.3 0 0.4 0 0.4 0 0\n"
    )
    return tmp_path


def test_truth_of_a_snippet_is_the_motion_field(snippet):
    truth = load_snippet(snippet, Camera(64, 48, 50.0, 50.0, 32.0, 24.0))
    assert truth.twists.twist(1_100_000_000).angular == pytest.approx([0.0, 0.3, 0.0])
    flow = truth.flows.displacement(1_000_000_000, 1_040_000_000)
    assert np.argwhere(flow.valid).tolist() == [[20, 10], [40, 30]]
    w, x, y = 0.22, (10 - 32) / 50, (20 - 24) / 50
    field = [-0.4 / 2 - (1 + x * x) * w, -x * y * w]  # at 2 m, the median of 1 and 3
    assert flow.displacement[20, 10] == pytest.approx(np.multiply(field, 50 * 0.04), rel=2e-3)


def test_as_many_depths_as_events(snippet, capsys):
    (snippet / "depth.txt").write_text("1\n2\n")
    with pytest.raises(Exception, match="2 depths for 3 events"):
        load_snippet(snippet, Camera(64, 48, 50.0, 50.0, 32.0, 24.0))


def test_first_row_of_real_mvsec(shared_data, monkeypatch, tmp_path, capsys):
    """0.22 s of indoor_flying1 with little motion: 5.9 px in 135 ms, |w| 8 deg/s, 0.14 m/s."""
    folder = shared_data / SNIPPET
    words = [str(folder), "--profiles", "realtime"]
    monkeypatch.setattr("sys.argv", ["comparison", *words, "--out", str(tmp_path)])
    assert comparison.main() == 0
    epe, outliers, w, _, _, windows = lines(capsys.readouterr().out)[folder.name, "realtime"]
    assert windows == "2 of 2"
    assert 0.2 < float(epe) < 1.2
    assert float(outliers) < 1
    assert 0.2 < float(w) < 2.5
