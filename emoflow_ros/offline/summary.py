"""The figures of merit of a whole evaluation, with confidence intervals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.offline.results import WindowResult

_RESAMPLES = 1000
_TAILS = (2.5, 97.5)  # percent: a 95 % interval

Values = NDArray[np.float64]
Statistic = Callable[[Values], float]


@dataclass(frozen=True)
class Measure:
    """One figure of merit over the windows that have it.

    Attributes:
        key: name in report.json.
        label: name for people.
        value: the figure, in `unit`.
        unit: its unit; empty for pure numbers.
        low, high: 95 % confidence interval by percentile bootstrap over windows; NaN where it
            makes no sense or fewer than two windows have the figure.
        windows: how many windows it is made of.
    """

    key: str
    label: str
    value: float
    unit: str
    low: float
    high: float
    windows: int


def summarise(windows: Sequence[WindowResult]) -> list[Measure]:
    """Compute every figure that the windows allow; those without any window are left out."""
    measures = [
        *_flow(windows),
        *_tracks(windows),
        *_angular(windows),
        *_linear(windows),
        *_effort(windows),
    ]
    return [measure for measure in measures if measure.windows]


def _flow(windows: Sequence[WindowResult]) -> list[Measure]:
    """Average over pixels first and over windows second, as MVSEC's benchmark does."""
    errors = [w.flow for w in windows if w.flow]

    def mean(key: str, label: str, unit: str, name: str) -> Measure:
        return _measure(key, label, unit, [getattr(e, name) for e in errors], np.mean)

    ratio = [(e.epe_px, e.truth_px) for e in errors]
    return [
        mean("epe_px", "Flow EPE", "px", "epe_px"),
        _measure("epe_percent", "Flow EPE / true displacement", "%", ratio, _percent_of_truth),
        mean("out_percent", "Outliers (EPE > 3 px)", "%", "pe3"),
        mean("pe2_percent", "2PE (EPE > 2 px)", "%", "pe2"),
        mean("pe1_percent", "1PE (EPE > 1 px)", "%", "pe1"),
        mean("ae_deg", "Flow angular error", "deg", "ae_deg"),
        mean("true_displacement_px", "True displacement", "px", "truth_px"),
    ]


def _tracks(windows: Sequence[WindowResult]) -> list[Measure]:
    errors = [w.tracks for w in windows if w.tracks]
    ratio = [(e.end_px, e.true_px) for e in errors]
    return [
        _measure(
            "track_error_px",
            "Track error since its start",
            "px",
            [e.end_px for e in errors],
            np.mean,
        ),
        _measure(
            "track_error_percent",
            "Track error / its true displacement",
            "%",
            ratio,
            _percent_of_truth,
        ),
    ]


def _angular(windows: Sequence[WindowResult]) -> list[Measure]:
    squares = [np.degrees(w.angular_error) ** 2 for w in windows]
    true = [np.degrees(w.truth.angular) ** 2 for w in windows if w.ok and w.truth]
    return [
        _measure("angular_rms_deg_s", "RMS error of ω", "deg/s", squares, _root_mean),
        _measure("true_angular_rms_deg_s", "RMS of true ω", "deg/s", true, _root_mean),
        _measure(
            "axis_error_deg",
            "Axis error of ω (median)",
            "deg",
            [w.axis_error_deg for w in windows],
            np.median,
        ),
        _measure("rate_ratio", "|ω| / true |ω| (median)", "", [w.rate_ratio for w in windows]),
    ]


def _linear(windows: Sequence[WindowResult]) -> list[Measure]:
    errors = [w.direction_error_deg for w in windows]
    known = [w for w in windows if w.ok and np.isfinite(w.true_direction).all()]
    observed = [100.0 * np.isfinite(w.linear).all() for w in known]
    scaled = [w.scaled_linear_error for w in known]
    turned = [w.turned_linear_error for w in known]
    return [
        _measure("direction_error_deg", "Direction error of v (median)", "deg", errors),
        _measure("direction_mean_deg", "Direction error of v (mean)", "deg", errors, np.mean),
        _measure(
            "oracle_linear_rms_m_s",
            "RMS error of v, oracle: scale from truth",
            "m/s",
            [error**2 for error in scaled],
            _root_mean,
        ),
        _measure(
            "oracle_sign_linear_rms_m_s",
            "RMS error of v, oracle: scale and sign from truth",
            "m/s",
            [error**2 for error in turned],
            _root_mean,
        ),
        _measure("observable_percent", "Moving windows with a v", "%", observed, np.mean),
    ]


def _effort(windows: Sequence[WindowResult]) -> list[Measure]:
    done = [w for w in windows if w.quality.runtime_s > 0]
    milliseconds = [1000 * w.quality.runtime_s for w in done]
    measures = [
        _measure(
            "contrast_gain",
            "Contrast gain FWL (median)",
            "",
            [w.quality.contrast_gain for w in done],
        ),
        _measure(
            "warm_runtime_p50_ms",
            "Time per warm window, median",
            "ms",
            [1000 * w.quality.runtime_s for w in done if w.quality.warm],
        ),
        _measure("runtime_p50_ms", "Time per window, median", "ms", milliseconds),
        _measure("runtime_p95_ms", "Time per window, 95 %", "ms", milliseconds, _percentile_95),
    ]
    if done:
        covered = (done[-1].t_end - done[0].t_start) / NS_PER_S
        factor = sum(w.quality.runtime_s for w in done) / covered
        nan = float("nan")
        measures.append(
            Measure("load", "Compute time / recorded time", factor, "", nan, nan, len(done))
        )
    return measures


def _measure(
    key: str, label: str, unit: str, rows: Sequence[Any], statistic: Statistic = np.median
) -> Measure:
    """Apply a statistic to the rows, numbers or short tuples, that are finite."""
    values = np.array([row for row in rows if np.isfinite(row).all()], np.float64)
    if len(values) == 0:
        return Measure(key, label, float("nan"), unit, float("nan"), float("nan"), 0)
    low, high = bootstrap_interval(values, statistic)
    return Measure(key, label, float(statistic(values)), unit, low, high, len(values))


def bootstrap_interval(values: Values, statistic: Statistic) -> tuple[float, float]:
    """95 % percentile interval of a statistic (Efron and Tibshirani, 1993), always the same.

    Args:
        values: (N, ...), the rows that are resampled.
        statistic: from such rows to the figure.

    Returns:
        Lower and upper end; NaN with fewer than two rows.
    """
    if len(values) < 2:
        return float("nan"), float("nan")
    rng = np.random.default_rng(0)
    draws = [
        statistic(values[rng.integers(len(values), size=len(values))]) for _ in range(_RESAMPLES)
    ]
    low, high = np.percentile(draws, _TAILS)
    return float(low), float(high)


def _root_mean(squares: Values) -> float:
    return float(np.sqrt(squares.mean()))


def _percentile_95(values: Values) -> float:
    return float(np.percentile(values, 95))


def _percent_of_truth(pairs: Values) -> float:
    """Mean error in percent of the mean true length, from (error, length) rows."""
    error, length = pairs.mean(axis=0)
    return float(100 * error / length) if length > 0 else float("nan")
