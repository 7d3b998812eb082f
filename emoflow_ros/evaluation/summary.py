"""The figures of merit of a whole evaluation, with confidence intervals."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.evaluation.metrics import Statistic, Values, bootstrap_interval
from emoflow_ros.evaluation.trajectory_errors import (
    RELATIVE_SPAN_S,
    local_path,
    longest,
    trajectories,
)
from emoflow_ros.evaluation.window_results import WindowResult
from emoflow_ros.truth import Truth


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


def summarise(windows: Sequence[WindowResult], speed: float | None = None) -> list[Measure]:
    """Compute every figure that the windows allow; those without any window are left out.

    Args:
        windows: in the order of time.
        speed: the camera's, m/s, where it is given; else scale is the truth's (an oracle).
    """
    return _known(
        [
            *_flow(windows),
            *_tracks(windows),
            *_velocity(windows),
            *_trajectory(windows, speed),
            *_local_trajectory(windows),
            *_effort(windows),
        ]
    )


def summarise_by_truth(
    windows: Sequence[WindowResult], truth: Truth
) -> dict[str, tuple[Measure, ...]]:
    """Compare the velocities with every source of truth, by its name; nothing with fewer than 2.

    The first figure says how far a source itself is from the first one.
    """
    if truth.twists is None or not truth.other_twists:
        return {}
    table = {truth.twists.name: tuple(_known(_velocity(windows)))}
    for i, source in enumerate(truth.other_twists):
        others = [window.against(window.other_truths[i]) for window in windows]
        apart = _distance(windows, others)
        table[source.name] = tuple(_known([apart, *_velocity(others)]))
    return table


def _known(measures: Sequence[Measure]) -> list[Measure]:
    return [measure for measure in measures if measure.windows]


def _flow(windows: Sequence[WindowResult]) -> list[Measure]:
    """Average over pixels first and over windows second, as MVSEC's benchmark does."""
    errors = [w.flow for w in windows if w.flow]
    static = [w.static_flow for w in windows if w.static_flow]
    moving = [w.flow for w in windows if w.flow and w.static_flow]

    def mean(key: str, label: str, unit: str, name: str, of: Sequence[Any] = errors) -> Measure:
        return _measure(key, label, unit, [getattr(e, name) for e in of], np.mean)

    ratio = [(e.epe_px, e.truth_px) for e in errors]
    return [
        mean("epe_px", "Flow EPE", "px", "epe_px"),
        _measure("epe_percent", "Flow EPE / true displacement", "%", ratio, _percent_of_truth),
        mean("out_percent", "Outliers, 3PE (EPE > 3 px)", "%", "pe3"),
        mean("pe2_percent", "2PE (EPE > 2 px)", "%", "pe2"),
        mean("pe1_percent", "1PE (EPE > 1 px)", "%", "pe1"),
        mean("ae_deg", "Flow angular error", "deg", "ae_deg"),
        mean("true_displacement_px", "True displacement", "px", "truth_px"),
        mean("moving_epe_px", "Flow EPE, windows with a moving object", "px", "epe_px", moving),
        mean("static_epe_px", "Flow EPE there, without its pixels", "px", "epe_px", static),
        mean("static_out_percent", "Outliers there, without its pixels", "%", "pe3", static),
    ]


def _tracks(windows: Sequence[WindowResult]) -> list[Measure]:
    errors = [w.tracks for w in windows if w.tracks]
    ends = [e.end_px for e in errors]
    ratio = [(e.end_px, e.true_px) for e in errors]
    return [
        _measure("track_error_px", "Track error since its start", "px", ends, np.mean),
        _measure(
            "track_error_percent",
            "Track error / its true displacement",
            "%",
            ratio,
            _percent_of_truth,
        ),
    ]


def _velocity(windows: Sequence[WindowResult]) -> list[Measure]:
    return [*_angular(windows), *_linear(windows)]


def _angular(windows: Sequence[WindowResult]) -> list[Measure]:
    squares = [np.degrees(w.angular_error) ** 2 for w in windows]
    true = [np.degrees(w.truth.angular) ** 2 for w in windows if w.told and w.truth]
    axis = [w.axis_error_deg for w in windows]
    ratio = [w.rate_ratio for w in windows]
    return [
        _measure("angular_rms_deg_s", "RMS error of ω", "deg/s", squares, _root_mean),
        _measure(
            "paper_angular_rms_deg_s",
            "RMS error of ω, paper: per window, then mean",
            "deg/s",
            squares,
            _mean_root,
        ),
        _measure("true_angular_rms_deg_s", "RMS of true ω", "deg/s", true, _root_mean),
        _measure("axis_error_deg", "Axis error of ω (median)", "deg", axis),
        _measure("rate_ratio", "|ω| / true |ω| (median)", "", ratio),
    ]


def _linear(windows: Sequence[WindowResult]) -> list[Measure]:
    errors = [w.direction_error_deg for w in windows]
    known = [w for w in windows if w.told and np.isfinite(w.true_direction).all()]
    observed = [100.0 * np.isfinite(w.linear).all() for w in known]
    return [
        _measure("direction_error_deg", "Direction error of v (median)", "deg", errors),
        _measure("direction_mean_deg", "Direction error of v (mean)", "deg", errors, np.mean),
        _measure("observable_percent", "Moving windows with a v", "%", observed, np.mean),
        _measure(
            "oracle_linear_rms_m_s",
            "RMS error of v, oracle: scale from truth",
            "m/s",
            [w.scaled_linear_error**2 for w in known],
            _root_mean,
        ),
        _measure(
            "paper_linear_rms_m_s",
            "RMS error of v, paper: scale and signs from truth",
            "m/s",
            [w.borrowed_linear_error**2 for w in known],
            _mean_root,
        ),
    ]


def _distance(windows: Sequence[WindowResult], others: Sequence[WindowResult]) -> Measure:
    squares = [
        np.degrees(a.truth.angular - b.truth.angular) ** 2
        for a, b in zip(windows, others, strict=True)
        if a.truth and b.truth
    ]
    return _measure(
        "truth_distance_deg_s", "RMS of its ω from the first's", "deg/s", squares, _root_mean
    )


def _trajectory(windows: Sequence[WindowResult], speed: float | None) -> list[Measure]:
    """Errors of the integrated velocities; the scale is named in key and label if it is true."""
    runs = trajectories(windows, speed)
    key, oracle = ("oracle_", ", oracle: speed from truth") if speed is None else ("", "")
    span = f"{RELATIVE_SPAN_S:g} s"
    over = [error for run in runs for error in run.relative_errors(RELATIVE_SPAN_S)]
    steps = [error[1] for run in runs for error in run.relative_errors(0.0)]
    run = longest(runs)
    moves = run is not None and run.has_translation
    absolute = run.absolute_errors.tolist() if run and moves else []
    return [
        _measure("rpe_step_deg", "RPE of rotation, window to window", "deg", steps, _rms),
        _measure("rpe_deg", f"RPE of rotation over {span}", "deg", [e[1] for e in over], _rms),
        _measure(
            f"{key}rpe_m",
            f"RPE of translation over {span}{oracle}",
            "m",
            [e[0] for e in over] if moves else [],
            _rms,
        ),
        _measure(f"{key}ate_m", f"ATE, aligned as a rigid body{oracle}", "m", absolute, _rms),
    ]


def _local_trajectory(windows: Sequence[WindowResult]) -> list[Measure]:
    """Errors of the longest run up to scale, after a similarity alignment."""
    run = local_path(windows)
    if run is None:
        return []
    span = f"over {RELATIVE_SPAN_S:g} s"
    errors, ways = run.relative_errors(RELATIVE_SPAN_S).T, run.ways(RELATIVE_SPAN_S)
    drift, rotation = (list(zip(of, ways, strict=True)) for of in errors)
    absolute = run.absolute_errors.tolist()
    return [
        _measure("sim3_ate_m", "ATE, aligned by a similarity", "m", absolute, _rms),
        _measure("way_m", "True way of the same run", "m", [run.length], np.mean),
        _measure("drift_percent", f"Drift of position {span} / way", "%", drift, _percent_of_truth),
        _measure("drift_deg_m", f"Drift of rotation {span} / way", "deg/m", rotation, _per_truth),
    ]


def _effort(windows: Sequence[WindowResult]) -> list[Measure]:
    done = [w for w in windows if w.quality.runtime_s > 0]
    milliseconds = [1000 * w.quality.runtime_s for w in done]
    warm = [1000 * w.quality.runtime_s for w in done if w.quality.warm]
    gain = [w.quality.contrast_gain for w in done]
    pace = list(zip((w.quality.runtime_s for w in done), _covered(done), strict=True))
    return [
        _measure("contrast_gain", "Contrast gain FWL (median)", "", gain),
        _measure("warm_runtime_p50_ms", "Time per warm window, median", "ms", warm),
        _measure("runtime_p50_ms", "Time per window, median", "ms", milliseconds),
        _measure("runtime_p95_ms", "Time per window, 95 %", "ms", milliseconds, _percentile_95),
        _measure(
            "real_time_factor",
            "Real-time factor (recorded / compute time)",
            "",
            pace,
            _recorded_per_compute,
        ),
    ]


def _covered(windows: Sequence[WindowResult]) -> list[float]:
    """Recorded time, s, that each window adds to those before it; gaps do not count."""
    ends = [w.t_start for w in windows[:1]] + [w.t_end for w in windows[:-1]]
    return [
        max(0, w.t_end - max(end, w.t_start)) / NS_PER_S
        for w, end in zip(windows, ends, strict=True)
    ]


def _measure(
    key: str, label: str, unit: str, rows: Sequence[Any], statistic: Statistic = np.median
) -> Measure:
    """Apply a statistic to the rows, numbers or short tuples, that are finite."""
    values = np.array([row for row in rows if np.isfinite(row).all()], np.float64)
    if len(values) == 0:
        return Measure(key, label, float("nan"), unit, float("nan"), float("nan"), 0)
    low, high = bootstrap_interval(values, statistic)
    return Measure(key, label, float(statistic(values, 0)), unit, low, high, len(values))


def _root_mean(squares: Values, axis: int) -> Values:
    """Root of the mean over all windows and axes."""
    return np.sqrt(squares.mean(axis=(axis, -1)))


def _mean_root(squares: Values, axis: int) -> Values:
    """Mean over windows of the root of each window's mean over its axes."""
    return np.asarray(np.sqrt(squares.mean(axis=-1)).mean(axis=axis))


def _rms(values: Values, axis: int) -> Values:
    return np.sqrt((values**2).mean(axis=axis))


def _percentile_95(values: Values, axis: int) -> Values:
    return np.asarray(np.percentile(values, 95, axis=axis))


def _percent_of_truth(pairs: Values, axis: int) -> Values:
    """Mean error in percent of the mean true length, from (error, length) rows."""
    return 100 * _per_truth(pairs, axis)


def _per_truth(pairs: Values, axis: int) -> Values:
    """Mean error over the mean true length, from (error, length) rows."""
    mean = pairs.mean(axis=axis)
    error, length = mean[..., 0], mean[..., 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(length > 0, error / length, np.nan))


def _recorded_per_compute(pairs: Values, axis: int) -> Values:
    total = pairs.sum(axis=axis)
    return np.asarray(total[..., 1] / total[..., 0])
