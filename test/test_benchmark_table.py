"""Rows with a target and a verdict, and the table of all benchmarks."""

import json
import sys
from pathlib import Path

import pytest

import benchmarks.__main__ as summary
from benchmarks._rows import Row, lay_out


@pytest.mark.parametrize(
    ("row", "target", "verdict"),
    [
        (Row("a", 1.0, at_most=1.0), "<= 1", "met"),
        (Row("a", 1.1, at_most=1.0), "<= 1", "missed"),
        (Row("a", 1.1, at_least=1.2), ">= 1.2", "missed"),
        (Row("a", 1.2, at_least=1.2), ">= 1.2", "met"),
        (Row("a", None, at_least=1.2), ">= 1.2", "not measured"),
        (Row("a", None, at_most=0), "<= 0", "not measured"),
        (Row("a", 9.0), "", ""),
    ],
)
def test_row(row, target, verdict):
    assert (row.target, row.verdict) == (target, verdict)
    assert Row.from_dict(json.loads(json.dumps(row.as_dict()))) == row


def test_rows_are_laid_out_side_by_side():
    lines = lay_out([Row("age, ms", 31.26, at_most=30), Row("windows", 1331)]).splitlines()
    assert lines[1].split() == ["age,", "ms", "<=", "30", "31.3", "missed"]
    assert lines[2].split() == ["windows", "1331"]


def test_all_benchmarks_are_summed_up_in_one_table(tmp_path, monkeypatch, capsys):
    """Two steps and a third one that fails; a fourth one has no part in a short run."""
    script = (
        "import json, sys\n"
        "args = dict(zip(sys.argv[1::2], sys.argv[2::2]))\n"
        "if '--fail' in args: sys.exit(2)\n"
        "row = {'figure': 'speed', 'result': float(args['--result']), 'at_most': 5.0}\n"
        "json.dump({'rows': [row]}, open(args['--out'], 'w'))\n"
    )
    for name in ("fast", "slow", "broken", "longest"):
        (tmp_path / f"{name}.py").write_text(script)
    monkeypatch.setattr(summary, "_HERE", tmp_path)
    steps = (
        summary.Step("fast", short=("--result", "4"), long=("--result", "3")),
        summary.Step("slow", short=("--result", "6"), long=("--result", "7")),
        summary.Step("broken", short=("--fail", "1")),
        summary.Step("longest", short=None, long=("--result", "8")),
    )
    (tmp_path / "broken.json").write_text('{"rows": [{"figure": "speed", "result": 1.0}]}')  # old
    monkeypatch.setattr(summary, "STEPS", steps)
    monkeypatch.setattr(sys, "argv", ["benchmarks", "--out", str(tmp_path)])
    assert summary.main() == 2
    printed = capsys.readouterr()
    table = [line.split()[-2:] for line in printed.out.splitlines() if line.startswith("speed")]
    assert table == [["4", "met"], ["6", "missed"]]
    assert "error: broken: failed" in printed.err


def test_every_step_is_a_benchmark():
    folder = Path(summary.__file__).parent
    named = {step.name for step in summary.STEPS}
    assert named == {path.stem for path in folder.glob("[a-z]*.py")}
