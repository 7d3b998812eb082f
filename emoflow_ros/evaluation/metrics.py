"""Error measures of flow and egomotion, their confidence intervals and significance.

EPE and outliers are defined as in MVSEC's evaluation (Zhu et al., RSS 2018), the angular error in
space-time as in Barron et al., IJCV 1994. Confidence intervals come from resampling windows,
significance from flipping the signs of differences (Efron and Tibshirani, 1993). Those of point
tracks are in `track_errors`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, permutation_test

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import Events

Vectors = NDArray[np.float64]
Flow = NDArray[np.floating[Any]]
Mask = NDArray[np.bool_]
Values = NDArray[np.float64]
# Of rows along an axis, for all places along the axes before it at once.
type Statistic = Callable[[Values, int], Any]

# An outlier, in px (%Out of the MVSEC benchmark).
OUTLIER_PX = 3.0
_RESAMPLES = 1000
_BATCH = 100  # resamples in memory at once


def event_mask(events: Events, width: int, height: int) -> Mask:
    """Mark the pixels (height, width) that hold an event. Events outside the image do not count."""
    mask = np.zeros((height, width), np.bool_)
    _mark(events.x, events.y, mask)
    return mask


@njit(nogil=True)
def _mark(x: NDArray[np.uint16], y: NDArray[np.uint16], mask: Mask) -> None:
    height, width = mask.shape
    for i in range(len(x)):
        if y[i] < height and x[i] < width:
            mask[y[i], x[i]] = True


@njit(nogil=True)
def known_flow_mask(truth: Flow) -> Mask:
    """Mark the pixels (H, W) whose true flow (H, W, 2) counts: finite, |u| > 0 and |v| > 0.

    MVSEC's files hold zeros where nothing is known, hence the second condition.
    """
    height, width, _ = truth.shape
    known = np.empty((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            u, v = truth[i, j]
            known[i, j] = np.isfinite(u) and np.isfinite(v) and u != 0 and v != 0
    return known


@njit(nogil=True)
def at_pixels(mask: Mask, flow: Flow) -> tuple[Vectors, Flow]:
    """Take the pixels of a mask (H, W), row by row, from a flow image (H, W, 2).

    Returns:
        Their columns and rows (N, 2), and their flow (N, 2).
    """
    count = np.count_nonzero(mask)
    pixels, values = np.empty((count, 2)), np.empty((count, 2), flow.dtype)
    k = 0
    for i in range(mask.shape[0]):
        for j in range(mask.shape[1]):
            if mask[i, j]:
                pixels[k, 0], pixels[k, 1] = j, i
                values[k] = flow[i, j]
                k += 1
    return pixels, values


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


@njit(nogil=True)
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
        statistic: from such rows and their axis to the figure, for many resamples at once.

    Returns:
        Lower and upper end; NaN with fewer than two rows, or where a value is NaN or infinite.
    """
    if len(values) < 2 or not np.isfinite(values).all():
        return float("nan"), float("nan")
    found = bootstrap(
        (np.arange(len(values)),),  # not the values: rows stay whole
        lambda rows, axis: statistic(values[rows], rows.ndim + axis),
        vectorized=True,
        n_resamples=_RESAMPLES,
        batch=_BATCH,
        method="percentile",  # BCa has no answer where all rows are equal
        rng=np.random.default_rng(0),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def paired_p_value(differences: Values) -> float:
    """Two-sided p-value of a mean difference (N,) of pairs, by flipping signs.

    The share of the ways to choose the signs of the differences whose mean is at least as far from
    zero as the mean itself: of all ways with up to 9 pairs, else of 1000 random ones, always the
    same, and the signs as they are. It is never below 1 / 1001. NaN with fewer than two pairs, or
    where a difference is NaN or infinite.
    """
    if len(differences) < 2 or not np.isfinite(differences).all():
        return float("nan")
    test = permutation_test(
        (differences,),
        lambda signed, axis: np.abs(signed.mean(axis=axis)),
        permutation_type="samples",
        vectorized=True,
        n_resamples=_RESAMPLES,
        batch=_BATCH,
        alternative="greater",  # of the absolute mean: both sides
        rng=np.random.default_rng(0),
    )
    return float(test.pvalue)
