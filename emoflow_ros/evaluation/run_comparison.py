"""`evaluate compare`: several runs side by side, and whether they differ."""

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.metrics import bootstrap_interval, paired_p_value
from emoflow_ros.evaluation.recording_options import make_folder
from emoflow_ros.report.documents import render, svg_uri, write_json
from emoflow_ros.report.figures import runs_over_time

_TEMPLATE = "comparison.html.j2"
# Errors per window: name in report.json, label, unit; less is better.
ERRORS = (
    ("epe_px", "Flow EPE", "px"),
    ("out_percent", "Outliers, 3PE", "%"),
    ("static_epe_px", "Flow EPE without moving objects", "px"),
    ("ae_deg", "Flow angular error", "deg"),
    ("angular_error_deg_s", "|error of ω|", "deg/s"),
    ("direction_error_deg", "Direction error of v", "deg"),
    ("runtime_s", "Time per window", "s"),
)
_CHARTS = ("epe_px", "angular_error_deg_s", "direction_error_deg")


@dataclass(frozen=True)
class Run:
    """A run's report.json under the name of its folder."""

    name: str
    report: dict[str, Any]

    def series(self, key: str) -> dict[tuple[float, float], float]:
        """A value per window (start and end in s), of the windows that have it."""
        return {
            (w["t_start_s"], w["t_end_s"]): float(w[key])
            for w in self.report["windows"]
            if w.get(key) is not None
        }


@dataclass(frozen=True)
class Difference:
    """How a run differs from the first one, over the windows that both have.

    Attributes:
        name: the run.
        key, label, unit: the error.
        windows: how many pairs.
        first, mean: the error of the first run and of this one, averaged over the pairs.
        difference, low, high: mean difference with its 95 % bootstrap interval.
        p: two-sided p-value of the mean difference, by random signs of the windows' differences;
            NaN with fewer than two pairs.
    """

    name: str
    key: str
    label: str
    unit: str
    windows: int
    first: float
    mean: float
    difference: float
    low: float
    high: float
    p: float

    @property
    def significant(self) -> bool:
        """Whether the difference is unlikely (p < 0.05) to be chance."""
        return self.p < 0.05


def main(arguments: Sequence[str]) -> int:
    """Compare the runs named on the command line."""
    parser = argparse.ArgumentParser(
        prog="evaluate compare",
        description="Put runs of 'evaluate' side by side and test whether they differ from the "
        "first one, window by window.",
        epilog="example: evaluate compare out/run1 out/run2 --out out/comparison",
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="folder of a run")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/comparison"),
        metavar="DIR",
        help="folder for comparison.html and comparison.json (default: out/comparison)",
    )
    options = parser.parse_args(arguments)
    runs = [load_run(path) for path in options.runs]
    if len(runs) < 2:
        raise InputError(options.runs[0], "one run alone", "give two or more to compare")
    make_folder(options.out)
    print(write_comparison(runs, options.out))
    return 0


def load_run(folder: Path) -> Run:
    """Read a run's report.

    Raises:
        InputError: no run in this folder.
    """
    path, fix = folder / "report.json", "give a folder written by 'evaluate'"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        if not {"windows", "summary", "configuration"} <= report.keys():
            raise KeyError("windows, summary or configuration is missing")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(path, f"cannot be read ({reason})", fix) from None
    except (ValueError, KeyError, AttributeError) as error:
        reason = " ".join(str(error).split())
        raise InputError(path, f"not a report ({reason})", fix) from None
    return Run(folder.name, report)


def write_comparison(runs: Sequence[Run], folder: Path) -> Path:
    """Write comparison.json and comparison.html; all other runs are compared with the first one.

    Raises:
        InputError: a run that has no window in common with the first one.
    """
    differences = [d for run in runs[1:] for d in compare(runs[0], run)]
    names = list(dict.fromkeys(key for run in runs for key in run.report["configuration"]))
    settings = {name: [run.report["configuration"].get(name) for run in runs] for name in names}
    changed = {name: values for name, values in settings.items() if len(set(map(str, values))) > 1}
    measures = {
        key: [run.report["summary"].get(key) for run in runs]
        for key in dict.fromkeys(key for run in runs for key in run.report["summary"])
    }
    charts = [
        (label, runs_over_time([(run.name, run.series(key)) for run in runs], label, unit))
        for key, label, unit in ERRORS
        if key in _CHARTS
    ]
    write_json(
        folder / "comparison.json",
        {
            "runs": [run.name for run in runs],
            "differences": [vars(d) | {"significant": d.significant} for d in differences],
            "changed_options": changed,
        },
    )
    page = folder / "comparison.html"
    text = render(
        _TEMPLATE,
        runs=runs,
        measures=measures,
        differences=differences,
        changed=changed,
        charts=[(title, svg_uri(chart)) for title, chart in charts if chart],
    )
    page.write_text(text, encoding="utf-8")
    return page


def compare(first: Run, other: Run) -> list[Difference]:
    """Pair the windows of two runs by their times and test each error.

    Raises:
        InputError: the runs have no window in common.
    """
    differences = []
    for key, label, unit in ERRORS:
        a, b = first.series(key), other.series(key)
        shared = sorted(a.keys() & b.keys())
        if shared:
            before = np.array([a[window] for window in shared])
            after = np.array([b[window] for window in shared])
            differences.append(_difference(other.name, key, label, unit, before, after))
    if not differences:
        raise InputError(
            other.name,
            f"no window in common with {first.name}",
            "compare runs on the same recording with the same windows",
        )
    return differences


def _difference(
    name: str,
    key: str,
    label: str,
    unit: str,
    before: NDArray[np.float64],
    after: NDArray[np.float64],
) -> Difference:
    change = after - before
    low, high = bootstrap_interval(change, np.mean)
    return Difference(
        name,
        key,
        label,
        unit,
        windows=len(change),
        first=float(before.mean()),
        mean=float(after.mean()),
        difference=float(change.mean()),
        low=low,
        high=high,
        p=paired_p_value(change),
    )
