"""The charts of the report; each function draws one figure."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.evaluation.trajectory_errors import Trajectory
from emoflow_ros.evaluation.window_results import WindowResult

ESTIMATE = "#1f5fa8"
TRUTH = "#222222"
# Colour and dashes of the first truth and of others.
_TRUTHS = ((TRUTH, "-"), ("#d9822b", (0, (4, 1.5))), ("#0b8043", (0, (1, 1))))
_BAND, _OURS = "± 2 standard deviations", "estimate"
_GRID = "#e4e4e4"
_AXES = "xyz"
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "axes.edgecolor": "#666666",
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": _GRID,
    "grid.linewidth": 0.7,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "figure.facecolor": "white",
    "svg.hashsalt": "emoflow_ros",
}
# Width, and room at the left, at the right and above axes, inches.
_WIDTH, _LEFT, _RIGHT, _TOP = 10.0, 0.85, 0.1, 0.3
_ROW, _HANDLE, _LETTER = 0.2, 0.6, 0.072  # height of a legend's row, width of a line and a letter
_NOTHING = np.full(3, np.nan)
style = mpl.rc_context(_STYLE)  # decorates every function that draws
Array = NDArray[np.float64]


@style
def twist_over_time(windows: Sequence[WindowResult], sources: Sequence[str] = ()) -> Figure | None:
    """Angular velocity and direction of linear velocity against truth; None for one window.

    Args:
        windows: in the order of time.
        sources: names of the first and the other truths.
    """
    if len(windows) < 2:
        return None
    columns, room = _legend_layout([*(f"truth: {name}" for name in sources), _BAND, _OURS])
    figure, axes = _subplots(3, 2, 4.85 + room, below=0.5 + room, sharex=True, sharey="col")
    t = middle_times(windows)
    truths = [(name, _seen_by(windows, i)) for i, name in enumerate(sources)]
    sigma = np.array([w.sigma for w in windows])
    rates = [
        (name, np.degrees([w.truth.angular if w.truth else _NOTHING for w in seen]))
        for name, seen in truths
    ]
    _components(
        list(axes[:, 0]),
        t,
        np.degrees([w.angular for w in windows]),
        np.degrees(sigma[:, 3:]),
        rates,
        "ω",
        "deg/s",
    )
    directions = [(name, np.array([w.true_direction for w in seen])) for name, seen in truths]
    linear = np.array([w.linear for w in windows])
    _components(list(axes[:, 1]), t, linear, sigma[:, :3], directions, "v", "1")
    axes[0, 0].set_title("Angular velocity", loc="left", fontweight="bold")
    axes[0, 1].set_title("Direction of linear velocity (unit)", loc="left", fontweight="bold")
    axes[0, 1].set_ylim(-1.15, 1.15)
    if not np.isfinite(linear).any():
        _say(axes[1, 1], "translation not observable in any window")
    for bottom in axes[2]:
        bottom.set_xlabel("time since the first window, s")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=columns)
    return figure


@style
def trajectory(path: Trajectory) -> Figure:
    """Estimated and true path: along the two longest directions of the truth, and over time."""
    figure, [[above, over_time]] = _subplots(1, 2, 3.6, width_ratios=(1, 1.25))
    ours, true = path.aligned, path.true[:, :3, 3]
    first, second = sorted(np.argsort(-np.ptp(true, axis=0))[:2])
    above.plot(true[:, first], true[:, second], color=TRUTH, linewidth=1.4, label="ground truth")
    above.plot(ours[:, first], ours[:, second], color=ESTIMATE, linewidth=1.4, label="estimate")
    above.plot(*true[0, [first, second]], "o", color=TRUTH, markersize=5, label="start")
    above.set_aspect("equal", adjustable="datalim")
    above.set_xlabel(f"{_AXES[first]} of the truth's world, m")
    above.set_ylabel(f"{_AXES[second]}, m")
    above.set_title("Path", loc="left", fontweight="bold")
    above.legend(loc="best")
    t = (path.times - path.times[0]) / NS_PER_S
    over_time.plot(t, path.absolute_errors, color=ESTIMATE, linewidth=1.4)
    over_time.set_ylim(0, None)
    over_time.set_xlabel("time since the run's start, s")
    over_time.set_ylabel("m")
    over_time.set_title("Distance from the true position", loc="left", fontweight="bold")
    return figure


@style
def errors_over_time(windows: Sequence[WindowResult]) -> Figure | None:
    """Errors per window; None where fewer than two have a truth."""
    rows = [row for row in error_series(windows) if np.isfinite(row[2]).sum() > 1]
    if not rows:
        return None
    figure, grid = _subplots(len(rows), 1, 1.5 * len(rows) + 0.5, sharex=True)
    axes = grid[:, 0]
    t = middle_times(windows)
    for ax, (name, unit, values) in zip(axes, rows, strict=True):
        ax.plot(t, values, color=ESTIMATE, **_line(values))
        middle = float(np.nanmedian(values))
        ax.axhline(middle, color="#c0392b", linewidth=0.9, linestyle=(0, (4, 3)))
        ax.set_title(f"{name} (median {middle:.3g} {unit})", loc="left")
        ax.set_ylabel(unit)
        ax.set_ylim(0, None)
    axes[-1].set_xlabel("time since the first window, s")
    return figure


@style
def error_histograms(windows: Sequence[WindowResult]) -> Figure | None:
    """How the errors spread over the windows; None with fewer than three windows."""
    rows = [row for row in error_series(windows) if np.isfinite(row[2]).sum() > 2]
    if not rows:
        return None
    figure, [axes] = _subplots(1, len(rows), 2.4)
    for ax, (name, unit, values) in zip(axes, rows, strict=True):
        known = values[np.isfinite(values)]
        ax.hist(known, bins=min(30, max(6, len(known) // 3)), color=ESTIMATE, edgecolor="white")
        ax.set_xlim(0, None)
        ax.set_title(name, loc="left")
        ax.set_xlabel(unit)
        ax.yaxis.get_major_locator().set_params(integer=True)
    axes[0].set_ylabel("windows")
    return figure


@style
def runs_over_time(
    runs: Sequence[tuple[str, Mapping[tuple[float, float], float]]], name: str, unit: str
) -> Figure | None:
    """One error of several runs, each as (name, value per window in s); None without values."""
    starts = [start for _, series in runs for start, _ in series]
    if not starts:
        return None
    figure, [[ax]] = _subplots(1, 1, 2.8)
    for run, series in runs:
        windows = sorted(series)
        middles = np.array([(start + end) / 2 for start, end in windows]) - min(starts)
        values = np.array([series[window] for window in windows])
        ax.plot(middles, values, label=run, **_line(values))
    ax.set_ylim(0, None)
    ax.set_ylabel(f"{name}, {unit}")
    ax.set_xlabel("time since the first window, s")
    ax.legend(ncols=len(runs), loc="upper right")
    return figure


def error_series(windows: Sequence[WindowResult]) -> list[tuple[str, str, Array]]:
    """List the errors per window: (name, unit, values with NaN where unknown)."""
    epe = np.array([w.flow.epe_px if w.flow else np.nan for w in windows])
    rate = np.degrees([np.linalg.norm(w.angular_error) for w in windows])
    direction = np.array([w.direction_error_deg for w in windows])
    return [
        ("Flow EPE", "px", epe),
        ("|error of ω|", "deg/s", rate),
        ("Direction error of v", "deg", direction),
    ]


def middle_times(windows: Sequence[WindowResult]) -> Array:
    """Middle of every window in s since the start of the first one."""
    middles = np.array([(w.t_start + w.t_end) / 2 for w in windows])
    return np.asarray((middles - windows[0].t_start) / NS_PER_S)


def _subplots(
    rows: int, columns: int, height: float, *, below: float = 0.45, **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Lay axes (rows, columns) out by hand, which is much faster than by a solver.

    Args:
        rows, columns: how many.
        height: of the figure, inches.
        below: room for what is below the axes, inches.
        options: of `Figure.subplots`.
    """
    figure = Figure(figsize=(_WIDTH, height))
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    wide = (_WIDTH - _LEFT - _RIGHT - (columns - 1) * _LEFT) / columns
    high = (height - _TOP - below - (rows - 1) * _TOP) / rows
    figure.subplots_adjust(
        left=_LEFT / _WIDTH,
        right=1 - _RIGHT / _WIDTH,
        bottom=below / height,
        top=1 - _TOP / height,
        wspace=_LEFT / wide,
        hspace=_TOP / high,
    )
    return figure, axes


def _legend_layout(labels: Sequence[str]) -> tuple[int, float]:
    """Number of columns in which a legend fits the figure, and its height in inches."""
    column = _HANDLE + _LETTER * max(map(len, labels))
    columns = max(1, min(len(labels), int(_WIDTH / column)))
    return columns, _ROW * math.ceil(len(labels) / columns) + 0.05


def _seen_by(windows: Sequence[WindowResult], source: int) -> list[WindowResult]:
    """Compare the windows with one of the truths; source 0 is the first one."""
    if source == 0:
        return list(windows)
    return [window.against(window.other_truths[source - 1]) for window in windows]


def _components(
    axes: Sequence[Axes],
    t: Array,
    values: Array,
    sigma: Array,
    truths: Sequence[tuple[str, Array]],
    symbol: str,
    unit: str,
) -> None:
    for i, ax in enumerate(axes):
        low, high = values[:, i] - 2 * sigma[:, i], values[:, i] + 2 * sigma[:, i]
        if np.isfinite(low).any():
            ax.fill_between(
                t, low, high, color=ESTIMATE, alpha=0.18, linewidth=0,
                label=_BAND,
            )  # fmt: skip
        for (name, true), (color, dashes) in zip(truths, _TRUTHS, strict=False):
            if np.isfinite(true[:, i]).any():
                look = _line(true[:, i], "s", 4.5) | {"color": color, "linestyle": dashes}
                ax.plot(t, true[:, i], label=f"truth: {name}", **look)
        ax.plot(t, values[:, i], color=ESTIMATE, label=_OURS, **_line(values[:, i]))
        ax.set_ylabel(f"{symbol}$_{_AXES[i]}$, {unit}" if unit != "1" else f"{symbol}$_{_AXES[i]}$")
        ax.axhline(0, color="#999999", linewidth=0.6, zorder=0)


def _line(values: Array, marker: str = "o", size: float = 3.0) -> dict[str, Any]:
    """Lines for long series, with markers where single windows would not show."""
    many = len(values) > 60
    return {
        "linewidth": 1.2,
        "marker": None if many else marker,
        "markersize": size,
        "markerfacecolor": "none" if marker == "s" else None,
    }


def _say(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", va="center", color="#777777")
