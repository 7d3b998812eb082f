"""Several runs side by side, and whether they differ."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.metrics import bootstrap_interval, paired_p_value

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
