"""How much an estimate tells beyond knowing nothing: a score that silence cannot improve.

All windows count whose image moves by 1 px or more and whose truth is known. The gain of a window
is the log density of the truth under the published mean and covariance (Student's t with 5 degrees
of freedom), less that of the truth for somebody who knows nothing, in bits. A window without an
estimate gains 0, one that is confident and wrong loses.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from benchmarks.scoreboard.uncertainty import VARIANCE_FLOOR, direction_errors
from benchmarks.scoreboard.windows import Windows

MOVES_PX = 1.0
FREEDOM = 5.0
# Root mean square of the true w about x, y and z in the middle of the 4468 windows, of 4800, of
# random seeds 0 to 59 that move by MOVES_PX or more. A constant, so that different runs compare.
W_SPREAD = np.radians([16.4, 13.3, 19.0])
_RADIUS = 2.0  # of the disc that the unit sphere is mapped to
_TURNS = 64  # directions that an average around the disc takes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """Scores of one recording over all windows that move by 1 px or more; NaN without any.

    Attributes:
        gain_w_bits: mean gain of information about w, bits.
        gain_w_windows: how many windows that is over: those whose true w is known.
        gain_v_bits: mean gain of information about v, bits.
        gain_v_windows: how many windows: those whose true parallax is at least 0.5 px.
        epe_share_all: sum of the end-point errors over that of the true ways, percent. A window
            without a flow counts as one whose flow is zero, and has 100 %.
        epe_share_windows: how many windows: those whose true flow is known exactly.
    """

    gain_w_bits: float
    gain_w_windows: int
    gain_v_bits: float
    gain_v_windows: int
    epe_share_all: float
    epe_share_windows: int


def scores_of(windows: Windows, w_scale: float = 1.0) -> Scores:
    """Score a recording's table.

    Args:
        windows: the table.
        w_scale: factor of the true angular velocity.
    """
    moving = windows[windows["moved_px"] >= MOVES_PX]
    w = angular_gains(
        moving["angular"], w_scale * moving["true_angular"], moving["angular_covariance"], W_SPREAD
    )
    v = direction_gains(moving["linear"], moving["true_linear"], moving["linear_covariance"])
    way = moving["truth_px"]
    error = np.where(np.isfinite(moving["epe_px"]), moving["epe_px"], way)
    compared = np.isfinite(way)
    whole = float(way[compared].sum())
    return Scores(
        gain_w_bits=_mean(w[np.isfinite(w)]),
        gain_w_windows=int(np.isfinite(w).sum()),
        gain_v_bits=_mean(v[np.isfinite(v)]),
        gain_v_windows=int(np.isfinite(v).sum()),
        epe_share_all=100.0 * float(error[compared].sum()) / whole if whole > 0 else math.nan,
        epe_share_windows=int(compared.sum()),
    )


def angular_gains(estimates: Array, truths: Array, covariances: Array, spread: Array) -> Array:
    """Gain of information about angular velocities, over a normal distribution around zero.

    Args:
        estimates: (N, 3); NaN where there is none.
        truths: (N, 3), in the same unit; NaN where unknown.
        covariances: (N, 3, 3) of the estimates.
        spread: (3,) standard deviations for somebody who knows nothing.

    Returns:
        (N,) bits, whatever the unit: 0 without an estimate, NaN where the truth is unknown.
    """
    told = _is_told(estimates, covariances)
    gains = np.zeros(len(estimates))
    before = -0.5 * (truths / spread) ** 2 - np.log(spread) - 0.5 * math.log(2 * math.pi)
    after = student_log_density((truths - estimates)[told], covariances[told])
    gains[told] = (after - before.sum(axis=1)[told]) / math.log(2)
    return np.where(np.isfinite(truths).all(axis=1), gains, np.nan)


def direction_gains(estimates: Array, truths: Array, covariances: Array) -> Array:
    """Gain of information about unit directions, over all directions being equally likely.

    The density is one by the area of the sphere. So the error on the tangent plane is drawn as on
    a map that keeps areas (Lambert's: an angle a has the length 2 sin(a / 2)), which brings the
    sphere onto a disc. The exponential map, where an angle has its own length, would need the
    factor a / sin(a), which makes the direction opposite to the estimate infinitely likely. What
    the density has beyond the disc is shared out over it: a covariance without bound gains 0.

    Args:
        estimates: (N, 3); NaN where none is given.
        truths: (N, 3); NaN where unknown.
        covariances: (N, 3, 3) of the estimates.

    Returns:
        (N,) bits: 0 without an estimate, NaN where the truth is unknown.
    """
    known = np.isfinite(truths).all(axis=1)
    told = _is_told(estimates, covariances) & known
    errors, across = direction_errors(estimates[told], truths[told], covariances[told])
    angles = np.linalg.norm(errors, axis=1, keepdims=True)
    drawn = errors * np.sinc(angles / (2 * math.pi))  # sinc(x) is sin(pi x) / (pi x)
    inside = student_log_density(drawn, across) - np.log(_share_on_disc(across))
    gains = np.where(known, 0.0, np.nan)
    gains[told] = (inside + math.log(4 * math.pi)) / math.log(2)
    return gains


def student_log_density(errors: Array, covariances: Array) -> Array:
    """Log density (N,) of errors (N, D) under Student's t with the covariances (N, D, D)."""
    dimensions = errors.shape[-1]
    scale = _scale(covariances)
    solved = np.linalg.solve(scale, errors[..., None])[..., 0]
    squares = (errors * solved).sum(axis=-1)
    half = (FREEDOM + dimensions) / 2
    constant = gammaln(half) - gammaln(FREEDOM / 2)
    constant -= dimensions / 2 * math.log(FREEDOM * math.pi)
    volume = np.linalg.slogdet(scale)[1] / 2
    return np.asarray(constant - volume - half * np.log1p(squares / FREEDOM))


def _share_on_disc(covariances: Array) -> Array:
    """Probability (N,) of the disc around the mean, for covariances (N, 2, 2).

    Standardised, the disc is an ellipse: the probability is the mean of that of the circles
    through its points, all directions being equally likely.
    """
    variances = np.linalg.eigvalsh(_scale(covariances))
    turns = (np.arange(_TURNS) + 0.5) * (2 * math.pi / _TURNS)
    along = variances @ np.stack([np.cos(turns) ** 2, np.sin(turns) ** 2])
    beyond = np.asarray((1 + _RADIUS**2 / (FREEDOM * along)) ** (-FREEDOM / 2))
    return np.asarray(1 - beyond.mean(axis=1))


def _scale(covariances: Array) -> Array:
    """Scale matrices of Student's t from its covariances (N, D, D), none of them singular."""
    floor = VARIANCE_FLOOR * np.eye(covariances.shape[-1])
    return np.asarray((covariances + floor) * ((FREEDOM - 2) / FREEDOM))


def _is_told(estimates: Array, covariances: Array) -> NDArray[np.bool_]:
    finite = np.isfinite(estimates).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    return np.asarray(finite)


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else math.nan
