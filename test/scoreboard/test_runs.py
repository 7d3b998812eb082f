"""Two runs of the scoreboard side by side, and rates by factor."""

import json
import math
import re

import numpy as np
import pytest
from scoreboard_tables import row

from benchmarks.scoreboard.compare import compare, describe, read_run
from benchmarks.scoreboard.figures import figures_of
from benchmarks.scoreboard.run import Outcome
from benchmarks.scoreboard.summary import breakdown, summarise
from benchmarks.scoreboard.verdicts import CRITERIA, judge
from benchmarks.scoreboard.windows import make_windows
from emoflow_ros.config import load_config
from emoflow_ros.errors import InputError
from emoflow_ros.report.documents import write_json


def recording(name, w_rms, *, accurate=True, v_median=5.0):
    return {
        "name": name,
        "accurate": accurate,
        "consistent": False,
        "criteria": dict.fromkeys(CRITERIA, True) | {"v": None},
        "figures": {"epe_percent": 9.0, "w_rms": w_rms, "v_median": v_median},
    }


def run_of(errors, **changed):
    return {str(k): recording(str(k), w, **changed) for k, w in enumerate(errors)}


def by_label(first, second):
    return {d.label: d for d in compare(first, second).differences}


def test_a_constant_change_has_an_interval_without_width():
    errors = np.random.default_rng(0).uniform(1, 9, 40)
    found = by_label(run_of(errors), run_of(errors - 0.5))["w error, deg/s, median"]
    assert (found.first, found.second) == pytest.approx((np.median(errors), found.first - 0.5))
    assert (found.difference, found.low, found.high) == pytest.approx((-0.5, -0.5, -0.5))


def test_the_interval_of_a_rate_is_that_of_a_binomial():
    """25 of 100 recordings become accurate: 25 % with a standard error of 4.33 %."""
    before = {k: recording(k, 1.0, accurate=False) for k in map(str, range(100))}
    after = {k: recording(k, 1.0, accurate=int(k) < 25) for k in before}
    found = by_label(before, after)["accurate, %"]
    assert found.difference == 25.0
    assert (found.low, found.high) == pytest.approx((25 - 1.96 * 4.33, 25 + 1.96 * 4.33), abs=1.6)


def test_pairs_are_resampled_together():
    """Recordings differ by far more than the runs do: unpaired intervals would be wide."""
    errors = np.linspace(1, 100, 50)
    found = by_label(run_of(errors), run_of(errors + 1))["w error, deg/s, median"]
    assert found.high - found.low < 1e-9


def test_figures_that_one_run_lacks_are_left_out():
    first = run_of([1.0, 2.0, 3.0])
    second = run_of([1.0, 2.0]) | {"2": recording("2", None), "9": recording("9", 1.0)}
    comparison = compare(first, second)
    assert {d.label: d for d in comparison.differences}["w error, deg/s, median"].recordings == 2
    assert comparison.only == ["9"]
    assert by_label(first, second)["v, %"].recordings == 0


def test_scores_come_first_and_are_left_out_where_a_run_is_older():
    first, second = run_of([1.0] * 3), run_of([1.0] * 3)
    older = by_label(first, second)
    assert older["gain of w, bits, mean"].recordings == 0
    for shares, found in (((10.0, 20.0, 80.0), first), ((5.0, 10.0, 40.0), second)):
        for recording_, share in zip(found.values(), shares, strict=True):
            gains = {"gain_w_bits": share - 30, "gain_v_bits": 1.0}
            recording_["figures"] |= gains | {"epe_share_all": share}
    differences = compare(first, second).differences
    assert [(d.label, round(d.first, 2), round(d.second, 2)) for d in differences[:6]] == [
        ("gain of w, bits, median", -10.0, -20.0),
        ("gain of w, bits, mean", 6.67, -11.67),
        ("gain of v, bits, median", 1.0, 1.0),
        ("gain of v, bits, mean", 1.0, 1.0),
        ("EPE with zero flow, %, median", 20.0, 10.0),
        ("EPE with zero flow, %, geometric mean", 25.2, 12.6),
    ]


def test_changed_verdicts_are_named():
    text = describe(compare(run_of([1.0, 1.0]), run_of([1.0, 1.0], accurate=False)))
    assert "0: no longer accurate" in text
    assert "consistent" not in text.partition("0: no longer")[2]
    assert "no recording changed" in describe(compare(run_of([1.0]), run_of([1.0])))


def test_runs_without_a_recording_in_common_are_refused():
    with pytest.raises(InputError, match="no recording in common"):
        compare(run_of([1.0]), {"other": recording("other", 1.0)})


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"format": 1, "recordings": [1]}'])
def test_files_that_are_no_run_are_refused(tmp_path, text):
    (tmp_path / "accuracy.json").write_text(text)
    with pytest.raises(InputError, match=re.escape(f"{tmp_path / 'accuracy.json'}: not a run")):
        read_run(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        read_run(tmp_path / "nothing.json")


def test_runs_of_before_the_verdict_was_renamed_are_read_and_that_is_said_once(tmp_path, capsys):
    older = run_of([1.0, 2.0])
    for one, verdict in zip(older.values(), (True, False), strict=True):
        del one["consistent"]
        one["honest"] = verdict
    path = tmp_path / "accuracy.json"
    path.write_text(json.dumps({"format": 1, "recordings": list(older.values())}))
    read = read_run(tmp_path)
    assert [one["consistent"] for one in read.values()] == [True, False]
    assert not any("honest" in one for one in read.values())
    line = f"{path}: of an older version: `honest` is taken as `consistent`"
    assert capsys.readouterr().err.splitlines() == [line]
    assert [c.verdict for c in compare(read, run_of([1.0, 2.0])).changed] == ["consistent"]


def outcome(name, factors, **changed):
    windows = make_windows([row(**changed)])
    figures = figures_of(windows)
    return Outcome(name, "random", figures, judge(figures), windows, factors=factors)


def test_a_run_is_written_and_read_again(tmp_path):
    outcomes = [outcome("random/0000", {"motion": "calm"}), outcome("random/0001", {}, epe_px=3.0)]
    document = summarise(outcomes, load_config(), ["real/x (gone)"], 0.5)
    write_json(tmp_path / "accuracy.json", document)
    assert document["rates"]["random"]["accurate"] == 50.0
    assert document["rates"]["random"]["epe"] == 50.0
    assert document["rates"]["all"]["recordings"] == 2
    assert document["scores"]["random"]["epe_share_all"] == {
        "recordings": 2,
        "median": 17.5,
        "geometric mean": pytest.approx(math.sqrt(5 * 30)),
    }
    assert json.loads((tmp_path / "accuracy.json").read_text())["missing"] == ["real/x (gone)"]
    runs = read_run(tmp_path)
    assert [c.name for c in compare(runs, runs).changed] == []
    assert runs["random/0001"]["criteria"]["epe"] is False


def test_factors_are_broken_down_by_terciles_and_words():
    outcomes = [
        outcome(str(k), {"speed": float(k), "scene": "room" if k < 4 else "street"}, epe_px=0.5 * k)
        for k in range(9)
    ]
    rows = [(r["factor"], r["value"], r["recordings"], r["accurate"]) for r in breakdown(outcomes)]
    assert rows == [
        ("scene", "room", 4, 50.0),  # an EPE of 0 and 0.5 px, then 1 and 1.5 of 10 px
        ("scene", "street", 5, 0.0),
        ("speed", "0 to 2.67", 3, pytest.approx(200 / 3)),
        ("speed", "2.67 to 5.33", 3, 0.0),
        ("speed", "5.33 to 8", 3, 0.0),
    ]


def test_few_numbers_stand_for_themselves():
    outcomes = [outcome(str(k), {"movers": k % 2}) for k in range(4)]
    assert [r["value"] for r in breakdown(outcomes)] == ["0", "1"]


def test_a_factor_that_is_mostly_zero_has_no_empty_third():
    outcomes = [outcome(str(k), {"flicker": max(0.0, k - 6.0)}) for k in range(10)]
    rows = [(r["value"], r["recordings"]) for r in breakdown(outcomes)]
    assert rows == [("0", 7), ("0 to 3", 3)]
