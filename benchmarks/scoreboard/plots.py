"""Plots of one recording: motion and flow error over time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.scoreboard.windows import Windows

_NS_PER_S = 1e9
_COLORS = ("#1f5fa8", "#d07c1f")
_AXES = ("x", "y", "z")
_BAND = 2  # standard deviations that are drawn


def motion_figure(windows: Windows) -> Figure:
    """Draw w, v and the flow's error of both cold starts against the truth.

    Bars are 2 standard deviations, by the covariance; both starts share the truth, in black.
    """
    figure = Figure(figsize=(11, 9), layout="constrained")
    axes: dict[str, Axes] = figure.subplot_mosaic("ad;be;cf;gg", sharex=True)
    origin = int(windows["t_begin"].min()) if len(windows) else 0
    seconds = ((windows["t_start"] + windows["t_end"]) / 2 - origin) / _NS_PER_S
    degrees = np.degrees(1)
    for k, axis in enumerate(_AXES):
        sigma = degrees * _sigma(windows["angular_covariance"], k)
        w, true = degrees * windows["angular"][:, k], degrees * windows["true_angular"][:, k]
        _draw(axes["abc"[k]], windows, seconds, w, sigma, true)
        axes["abc"[k]].set_ylabel(f"w {axis}, deg/s")
        sigma = _sigma(windows["linear_covariance"], k)
        _draw(
            axes["def"[k]],
            windows,
            seconds,
            windows["linear"][:, k],
            sigma,
            windows["true_linear"][:, k],
        )
        axes["def"[k]].set(ylabel=f"v {axis}, unit", ylim=(-1.3, 1.3))
    _draw_flow(axes["g"], windows, seconds)
    axes["a"].set_title("angular velocity")
    axes["d"].set_title("direction of translation")
    axes["a"].legend(loc="best", fontsize=8)
    for each in axes.values():
        each.grid(alpha=0.3)
    return figure


def _draw(
    axis: Axes,
    windows: Windows,
    seconds: NDArray[np.float64],
    values: NDArray[np.float64],
    sigma: NDArray[np.float64],
    true: NDArray[np.float64],
) -> None:
    """Draw one component; the range follows truth and estimates, not their bars."""
    for start, color in enumerate(_COLORS):
        chosen = (windows["start"] == start) & np.isfinite(values)
        axis.errorbar(
            seconds[chosen],
            values[chosen],
            _BAND * sigma[chosen],
            fmt="o",
            ms=3,
            lw=1,
            color=color,
            label=f"start {start + 1}, {_BAND} sigma",
        )
    order = np.argsort(seconds, kind="stable")
    axis.plot(seconds[order], true[order], color="black", lw=1.2, label="truth")
    seen = np.concatenate([values, true])
    seen = seen[np.isfinite(seen)]
    if len(seen):
        margin = 0.15 * max(1.0, float(np.ptp(seen)))
        axis.set_ylim(seen.min() - margin, seen.max() + margin)


def _draw_flow(axis: Axes, windows: Windows, seconds: NDArray[np.float64]) -> None:
    for start, color in enumerate(_COLORS):
        chosen = windows["start"] == start
        axis.plot(
            seconds[chosen],
            windows["epe_px"][chosen],
            "o-",
            ms=3,
            lw=1,
            color=color,
            label=f"EPE, start {start + 1}",
        )
    order = np.argsort(seconds, kind="stable")
    moved = windows["moved_px"][order]
    axis.plot(seconds[order], moved, color="black", lw=1.2, label="true way of the image")
    axis.set(xlabel="time from the first event, s", ylabel="px")
    axis.set_ylim(bottom=0.0)
    axis.legend(loc="best", fontsize=8)


def _sigma(covariances: NDArray[np.float64], k: int) -> NDArray[np.float64]:
    return np.sqrt(np.maximum(covariances[:, k, k], 0.0))
