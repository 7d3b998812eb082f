"""The scores of many recordings: how they are called, and their medians and means."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import gmean

from benchmarks.scoreboard.figures import Figures


@dataclass(frozen=True)
class Score:
    """One score of a recording.

    Attributes:
        figure: its name in Figures.
        windows: the name there of how many windows it is over.
        label: what it is, with its unit.
        digits: that are shown after the point.
        mean: its mean over recordings, of numbers along an axis. A gain may be negative, so only
            EPE has a geometric one.
        mean_name: what this mean is called.
    """

    figure: str
    windows: str
    label: str
    digits: int
    mean: Callable[..., Any]
    mean_name: str


SCORES = (
    Score("gain_w_bits", "gain_w_windows", "gain of w, bits", 2, np.mean, "mean"),
    Score("gain_v_bits", "gain_v_windows", "gain of v, bits", 2, np.mean, "mean"),
    Score(
        "epe_share_all", "epe_share_windows", "EPE with zero flow, %", 1, gmean, "geometric mean"
    ),
)


def summarise_scores(figures: Sequence[Figures]) -> dict[str, dict[str, Any]]:
    """Median and mean of each score by its name, over the recordings that have it."""
    found = {}
    for score in SCORES:
        values = np.array([getattr(some, score.figure) for some in figures], np.float64)
        values = values[np.isfinite(values)]
        found[score.figure] = {
            "recordings": len(values),
            "median": float(np.median(values)) if len(values) else math.nan,
            score.mean_name: float(score.mean(values)) if len(values) else math.nan,
        }
    return found
