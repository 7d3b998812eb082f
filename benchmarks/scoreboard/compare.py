"""Compare two runs of the scoreboard, recording by recording.

Takes the recordings that both runs have. The intervals say how far a difference may be chance:
95 %, from the recordings resampled in pairs.
"""

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

from benchmarks.scoreboard.score_summary import SCORES
from benchmarks.scoreboard.summary import FORMAT
from benchmarks.scoreboard.verdicts import CRITERIA
from emoflow_ros.cli import run
from emoflow_ros.errors import InputError, say

_RESAMPLES = 2000
_CONFIDENCE = 0.95
_VERDICTS = ("accurate", "consistent")
_LABEL_WIDTH = 38
_FIX = "give the accuracy.json of a run, or its folder"

Recording = Mapping[str, Any]
Values = NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """One figure of two runs over the recordings that have it in both.

    Attributes:
        label: what it is, with its unit.
        first, second: the figure of either run.
        difference: the second less the first.
        low, high: 95 % interval of the difference; NaN with fewer than two recordings.
        recordings: how many have it in both.
    """

    label: str
    first: float
    second: float
    difference: float
    low: float
    high: float
    recordings: int


@dataclass(frozen=True)
class Changed:
    """A recording whose verdict changed: `accurate` or `consistent`, and what it is now."""

    name: str
    verdict: str
    now: bool


@dataclass(frozen=True)
class Comparison:
    """Two runs side by side.

    Attributes:
        differences: of scores, rates and figures.
        changed: recordings with another verdict.
        only: names of recordings that one run alone has.
    """

    differences: list[Difference]
    changed: list[Changed]
    only: list[str]


def main() -> int:
    """Entry point."""
    return run(_run)


def _run() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scoreboard.compare", description=__doc__
    )
    for name, which in (("first", "before"), ("second", "after")):
        parser.add_argument(name, type=Path, metavar=name.upper(), help=f"the run {which}")
    options = parser.parse_args()
    print(describe(compare(read_run(options.first), read_run(options.second))))


def read_run(path: Path) -> dict[str, Recording]:
    """Read a run's recordings by name.

    Args:
        path: an accuracy.json, or the folder that holds one.

    Raises:
        InputError: no such file, or not one of a run.
    """
    file = path / "accuracy.json" if path.is_dir() else path
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if document["format"] != FORMAT:
            raise InputError(file, f"of format {document['format']}, not {FORMAT}", _FIX)
        recordings = [_of_today(recording, file) for recording in document["recordings"]]
        return {recording["name"]: recording for recording in recordings}
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})", _FIX) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(file, "not a run of the scoreboard", _FIX) from None


def _of_today(recording: Recording, file: Path) -> Recording:
    """Return a recording with the names of today."""
    if "honest" not in recording:
        return recording
    say(file, "of an older version: `honest` is taken as `consistent`")
    return {"consistent" if name == "honest" else name: recording[name] for name in recording}


def compare(first: Mapping[str, Recording], second: Mapping[str, Recording]) -> Comparison:
    """Pair the recordings of two runs.

    Raises:
        InputError: they have none in common.
    """
    names = [name for name in first if name in second]
    if not names:
        raise InputError("the two runs", "have no recording in common", "give runs of the same")
    pairs = [(first[name], second[name]) for name in names]
    differences = []
    for score in SCORES:
        value = _figure(score.figure)
        differences += [
            _difference(f"{score.label}, median", pairs, value, np.median),
            _difference(f"{score.label}, {score.mean_name}", pairs, value, score.mean),
        ]
    differences += [
        _difference(f"{verdict}, %", pairs, _percent_of(verdict), np.mean) for verdict in _VERDICTS
    ]
    differences += [
        _difference(f"{name}, %", pairs, _criterion(name), np.mean) for name in CRITERIA
    ]
    for key, label in (
        ("epe_percent", "EPE of displacement, %, median"),
        ("w_rms", "w error, deg/s, median"),
        ("v_median", "v error, deg, median"),
    ):
        differences.append(_difference(label, pairs, _figure(key), np.median))
    changed = [
        Changed(name, verdict, bool(second[name][verdict]))
        for verdict in _VERDICTS
        for name in names
        if first[name][verdict] != second[name][verdict]
    ]
    return Comparison(differences, changed, sorted(set(first) ^ set(second)))


def describe(comparison: Comparison) -> str:
    """Lay a comparison out for people."""
    heads = f"{'first':>8}{'second':>8}{'change':>8}   {'95 % interval':<20}recordings"
    lines = [f"{'':<{_LABEL_WIDTH}}{heads}"]
    for d in comparison.differences:
        interval = f"[{d.low:+.2f}, {d.high:+.2f}]" if math.isfinite(d.low) else "-"
        numbers = f"{d.first:>8.2f}{d.second:>8.2f}{d.difference:>+8.2f}"
        lines.append(f"{d.label:<{_LABEL_WIDTH}}{numbers}   {interval:<20}{d.recordings}")
    for change in comparison.changed:
        lines.append(f"{change.name}: {'now' if change.now else 'no longer'} {change.verdict}")
    if not comparison.changed:
        lines.append("no recording changed its verdict")
    if comparison.only:
        lines.append(f"in one run only: {', '.join(comparison.only)}")
    return "\n".join(lines)


def _difference(
    label: str,
    pairs: list[tuple[Recording, Recording]],
    value: Callable[[Recording], float],
    statistic: Callable[..., Any],
) -> Difference:
    """Compare a statistic over the recordings that have a value in both runs."""
    values = np.array([[value(a), value(b)] for a, b in pairs])
    first, second = values[np.isfinite(values).all(axis=1)].T
    if not len(first):
        return Difference(label, math.nan, math.nan, math.nan, math.nan, math.nan, 0)
    a, b = float(statistic(first)), float(statistic(second))
    low, high = _interval(first, second, statistic)
    return Difference(label, a, b, b - a, low, high, len(first))


def _interval(first: Values, second: Values, statistic: Callable[..., Any]) -> tuple[float, float]:
    """95 % percentile interval of the change, the same for the same values."""
    if len(first) < 2:
        return math.nan, math.nan
    result = bootstrap(
        (first, second),
        lambda a, b, axis: statistic(b, axis=axis) - statistic(a, axis=axis),
        paired=True,
        vectorized=True,
        n_resamples=_RESAMPLES,
        confidence_level=_CONFIDENCE,
        method="percentile",  # BCa has no answer where all pairs are equal
        rng=np.random.default_rng(0),
    )
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def _percent_of(verdict: str) -> Callable[[Recording], float]:
    return lambda recording: 100.0 * recording[verdict]


def _criterion(name: str) -> Callable[[Recording], float]:
    """Whether it is met; NaN where it is not judged, or the run's version did not have it."""
    return lambda recording: _number(recording["criteria"].get(name), 100.0)


def _figure(key: str) -> Callable[[Recording], float]:
    """A figure; NaN where there is none, or the run is of a version that did not have it."""
    return lambda recording: _number(recording["figures"].get(key))


def _number(value: float | None, factor: float = 1.0) -> float:
    return math.nan if value is None else factor * value


if __name__ == "__main__":
    sys.exit(main())
