"""Error measures of flow and egomotion, as the benchmarks of the field define them.

Definitions: EPE and outliers as in MVSEC's evaluation (Zhu et al., RSS 2018), the angular error
in space-time as in Barron et al., IJCV 1994.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import Events

Vectors = NDArray[np.float64]
Flow = NDArray[np.floating]
Mask = NDArray[np.bool_]

# An outlier, in px (%Out of the MVSEC benchmark).
OUTLIER_PX = 3.0


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
    known = np.isfinite(flow[:, 0]) & np.isfinite(flow[:, 1])
    if not known.any():
        return None
    ours, true = flow[known].astype(np.float64), truth[known].astype(np.float64)
    errors = end_point_error(ours, true)
    above = [100.0 * float((errors > px).mean()) for px in (1.0, 2.0, OUTLIER_PX)]
    return FlowErrors(
        epe_px=float(errors.mean()),
        pe1=above[0],
        pe2=above[1],
        pe3=above[2],
        ae_deg=float(space_time_angle_deg(ours, true).mean()),
        truth_px=float(end_point_error(true, np.zeros(2)).mean()),
        pixels=len(errors),
    )


def end_point_error(flow: Flow, truth: Flow) -> Flow:
    """Length of the difference of two displacements (..., 2), px."""
    u, v = flow[..., 0] - truth[..., 0], flow[..., 1] - truth[..., 1]
    return np.asarray(np.sqrt(u * u + v * v))


def space_time_angle_deg(flow: Vectors, truth: Vectors) -> Vectors:
    """Angle between (u, v, 1) and (u', v', 1) for displacements (N, 2), in degrees."""
    (u, v), (a, b) = flow.T, truth.T
    sine = np.sqrt((v - b) ** 2 + (a - u) ** 2 + (u * b - v * a) ** 2)
    return np.asarray(np.degrees(np.arctan2(sine, u * a + v * b + 1)))


def angle_deg(a: Vectors, b: Vectors) -> Vectors:
    """Angle between vectors (..., 3) in degrees, 0 to 180, signs kept; NaN for a zero vector.

    Serves as direction error of v and as axis error of w.
    """
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    cosine = (a * b).sum(axis=-1)
    angle = np.degrees(np.arctan2(sine, cosine))
    is_zero = (np.abs(a).max(axis=-1) == 0) | (np.abs(b).max(axis=-1) == 0)
    return np.asarray(np.where(is_zero, np.nan, angle))
