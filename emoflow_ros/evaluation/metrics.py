"""Error measures of flow and egomotion, their confidence intervals and significance.

EPE and outliers are defined as in MVSEC's evaluation (Zhu et al., RSS 2018), the angular error in
space-time as in Barron et al., IJCV 1994. Confidence intervals and significance come from
resampling windows (Efron and Tibshirani, 1993).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import Events

Vectors = NDArray[np.float64]
Flow = NDArray[np.floating]
Mask = NDArray[np.bool_]
Values = NDArray[np.float64]
Statistic = Callable[[Values], float]

# An outlier, in px (%Out of the MVSEC benchmark).
OUTLIER_PX = 3.0
_RESAMPLES = 1000
_TAILS = (2.5, 97.5)  # percent: a 95 % interval


def event_mask(events: Events, width: int, height: int) -> Mask:
    """Mark the pixels that hold at least one event, (height, width)."""
    mask = np.zeros((height, width), np.bool_)
    mask[events.y, events.x] = True
    return mask


def known_flow_mask(truth: Flow) -> Mask:
    """Mark the pixels (H, W) whose true flow (H, W, 2) counts: finite, |u| > 0 and |v| > 0.

    MVSEC's files hold zeros where nothing is known, hence the second condition.
    """
    u, v = truth[..., 0], truth[..., 1]
    return np.asarray(np.isfinite(u) & np.isfinite(v) & (u != 0) & (v != 0))


@dataclass(frozen=True)
class FlowErrors:
    """Errors of one window's displacement over the pixels that were compared.

    Attributes:
        epe_px: mean end-point error, px.
        pe1, pe2, pe3: share of pixels with an end-point error above 1, 2 and 3 px, percent;
            pe3 is %Out.
        ae_deg: mean space-time angle between (u, v, 1) and the true (u, v, 1), degrees.
        truth_px: mean length of the true displacement, px.
        pixels: how many pixels were compared.
    """

    epe_px: float
    pe1: float
    pe2: float
    pe3: float
    ae_deg: float
    truth_px: float
    pixels: int


def flow_errors(flow: Flow, truth: Flow) -> FlowErrors | None:
    """Compare displacements with the true ones, both (N, 2) px: one row per compared pixel.

    Returns:
        None where no pixel has an estimate.
    """
    pixels, epe, above_1, above_2, above_3, angle, length = _sums(flow, truth)
    if not pixels:
        return None
    return FlowErrors(
        epe_px=epe / pixels,
        pe1=100.0 * above_1 / pixels,
        pe2=100.0 * above_2 / pixels,
        pe3=100.0 * above_3 / pixels,
        ae_deg=math.degrees(angle / pixels),
        truth_px=length / pixels,
        pixels=pixels,
    )


@numba.njit(cache=True, nogil=True)
def _sums(flow: Flow, truth: Flow) -> tuple[int, float, int, int, int, float, float]:
    """Count the pixels with an estimate and add up what `flow_errors` averages; angles in rad."""
    pixels = above_1 = above_2 = above_3 = 0
    epe = angle = length = 0.0
    for i in range(len(flow)):
        u, v, a, b = flow[i, 0], flow[i, 1], np.float64(truth[i, 0]), np.float64(truth[i, 1])
        if not (np.isfinite(u) and np.isfinite(v)):
            continue
        error = math.sqrt((u - a) ** 2 + (v - b) ** 2)
        sine = math.sqrt((v - b) ** 2 + (a - u) ** 2 + (u * b - v * a) ** 2)
        pixels += 1
        epe += error
        above_1 += error > 1.0
        above_2 += error > 2.0
        above_3 += error > OUTLIER_PX
        angle += math.atan2(sine, u * a + v * b + 1.0)
        length += math.sqrt(a * a + b * b)
    return pixels, epe, above_1, above_2, above_3, angle, length


def end_point_error(flow: Flow, truth: Flow) -> Flow:
    """Length of the difference of two displacements (..., 2), px."""
    u, v = flow[..., 0] - truth[..., 0], flow[..., 1] - truth[..., 1]
    return np.asarray(np.sqrt(u * u + v * v))


def angle_deg(a: Vectors, b: Vectors) -> Vectors:
    """Angle between vectors (..., 3) in degrees, 0 to 180, signs kept; NaN for a zero vector.

    Serves as direction error of v and as axis error of w.
    """
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    cosine = (a * b).sum(axis=-1)
    angle = np.degrees(np.arctan2(sine, cosine))
    is_zero = (np.abs(a).max(axis=-1) == 0) | (np.abs(b).max(axis=-1) == 0)
    return np.asarray(np.where(is_zero, np.nan, angle))


def bootstrap_interval(values: Values, statistic: Statistic) -> tuple[float, float]:
    """95 % percentile interval of a statistic, always the same for the same values.

    Args:
        values: (N, ...), the rows that are resampled.
        statistic: from such rows to the figure.

    Returns:
        Lower and upper end; NaN with fewer than two rows.
    """
    if len(values) < 2:
        return float("nan"), float("nan")
    low, high = np.percentile(_draws(values, statistic), _TAILS)
    return float(low), float(high)


def paired_p_value(differences: Values) -> float:
    """Two-sided p-value of a mean difference (N,) of pairs, against the mean being zero.

    The share of resampled means, of the differences less their mean, that are at least as far
    from zero as the mean itself; never below 1 / 1001. NaN with fewer than two pairs.
    """
    if len(differences) < 2:
        return float("nan")
    mean = differences.mean()
    draws = _draws(differences - mean, np.mean)
    return float((1 + (np.abs(draws) >= abs(mean)).sum()) / (1 + _RESAMPLES))


def _draws(values: Values, statistic: Statistic) -> Values:
    rng = np.random.default_rng(0)
    rows = len(values)
    return np.array([statistic(values[rng.integers(rows, size=rows)]) for _ in range(_RESAMPLES)])
