"""Figures of one recording from its table of windows.

All windows of both cold starts count, none is left out, except where a figure's definition says
so. A window *moves* where `moved_px` is at least 3 px; a window whose truth is silent neither moves
nor rests.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.scoreboard.information import Scores, scores_of
from benchmarks.scoreboard.uncertainty import direction_errors, normalised_squares, sigma_along
from benchmarks.scoreboard.windows import Windows

MOVING_PX = 3.0
PARALLAX_PX = 2.0
SIGMAS = 3.0
WRONG_W_DEG_S = 5.0
WRONG_V_DEG = 20.0
STILL_W_DEG_S = 1.0
LOST_SHARE = 0.5
W_DEG_S = 2.5
W_SHARE = 0.08
_REVERSED_DEG = 90.0

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Errors:
    """Errors per window (N,), in degrees and degrees per second; NaN where there is none.

    Attributes:
        w: length of the error of the angular velocity, against the scaled truth.
        w_raw: the same against the truth as it is.
        w_true: length of the scaled true angular velocity.
        w_scale: the truth's factor (a scalar), 1 unless a gyro's scale is uncertain.
        w_nees, v_nees: error squared over covariance and degrees of freedom.
        w_sigma, v_sigma: standard deviation, by the covariance, along the error.
        v: angle between the directions of translation, sign included, 0 to 180.
    """

    w: Values
    w_raw: Values
    w_true: Values
    w_scale: float
    w_nees: Values
    w_sigma: Values
    v: Values
    v_nees: Values
    v_sigma: Values

    @property
    def w_wrong(self) -> Mask:
        """Beyond 3 own standard deviations and beyond 5 deg/s."""
        return (self.w > SIGMAS * self.w_sigma) & (self.w > WRONG_W_DEG_S)

    @property
    def v_wrong(self) -> Mask:
        """Beyond 3 own standard deviations and beyond 20 degrees."""
        return (self.v > SIGMAS * self.v_sigma) & (self.v > WRONG_V_DEG)

    @property
    def still_wrong(self) -> Mask:
        """Beyond 3 own standard deviations and beyond 1 deg/s: too much for a camera at rest."""
        return (self.w > SIGMAS * self.w_sigma) & (self.w > STILL_W_DEG_S)


@dataclass(frozen=True)
class Figures(Scores):
    """Scores and figures of one recording; NaN where no window has them. Shares are in percent.

    Attributes:
        windows, estimates: how many windows there are, and how many have an estimate.
        moving, still: windows that move by at least 3 px, and that do not.
        covered_moving, covered_still: share of those with an estimate.
        flow_moving: share of the moving windows with a flow whose truth is known.
        epe_px: mean over windows with a flow of the mean end-point error over event pixels.
        truth_px: mean true displacement of the same pixels of the same windows.
        epe_percent: the one over the other.
        w_rms: root mean square of the length of w's error, deg/s, windows with an estimate.
        w_true_rms: of the true angular velocity in the same windows, deg/s.
        w_percent: the one over the other.
        w_raw_rms, w_scale: the error without the gyro's scale, and that scale.
        v_median, v_90: signed direction error of v where v is given and the true parallax
            exceeds 2 px: median and 90 % quantile, degrees.
        v_reversed: share of the same windows beyond 90 degrees.
        v_windows: how many these are.
        v_given: share of the windows with an estimate and such parallax that give v.
        nees_w, nees_v: mean normalised error squared, of w over all windows with an estimate, of
            v over those that give it and whose true parallax is at least 0.5 px.
        confident_wrong: share of the windows with an estimate whose w or v is confident and wrong.
        confident_wrong_w, confident_wrong_v: the same by w and by v alone.
        lost: share of the moving windows with an estimate whose EPE exceeds half of the way.
        still_wrong: share of the windows that do not move and whose estimate is beyond 3 own
            standard deviations and beyond 1 deg/s.
        settled_s: time from the start until w stays within 2.5 deg/s or 8 % of w_true_rms,
            whichever is larger: the longer one of the two starts, infinite if one never does.
        window_ms: median time that an estimate took.
    """

    windows: int
    estimates: int
    moving: int
    still: int
    covered_moving: float
    covered_still: float
    flow_moving: float
    epe_px: float
    truth_px: float
    epe_percent: float
    w_rms: float
    w_true_rms: float
    w_percent: float
    w_raw_rms: float
    w_scale: float
    v_median: float
    v_90: float
    v_reversed: float
    v_windows: int
    v_given: float
    nees_w: float
    nees_v: float
    confident_wrong: float
    confident_wrong_w: float
    confident_wrong_v: float
    lost: float
    still_wrong: float
    settled_s: float
    window_ms: float


def errors_of(windows: Windows, gyro_scale: float = 1.0) -> Errors:
    """Compare every window's motion with the truth.

    Args:
        windows: the table.
        gyro_scale: the truth of w is multiplied by the factor in [1, gyro_scale] that fits best.
    """
    scale = _best_scale(windows["angular"], windows["true_angular"], gyro_scale)
    raw = np.degrees(windows["angular"] - windows["true_angular"])
    error = np.degrees(windows["angular"] - scale * windows["true_angular"])
    covariance = windows["angular_covariance"] * np.degrees(1) ** 2
    across, across_covariance = direction_errors(
        windows["linear"], windows["true_linear"], windows["linear_covariance"]
    )
    return Errors(
        w=np.linalg.norm(error, axis=1),
        w_raw=np.linalg.norm(raw, axis=1),
        w_true=scale * np.degrees(np.linalg.norm(windows["true_angular"], axis=1)),
        w_scale=scale,
        w_nees=normalised_squares(error, covariance),
        w_sigma=sigma_along(error, covariance),
        v=np.degrees(np.linalg.norm(across, axis=1)),
        v_nees=normalised_squares(across, across_covariance),
        v_sigma=np.degrees(sigma_along(across, across_covariance)),
    )


def figures_of(windows: Windows, gyro_scale: float = 1.0) -> Figures:
    """Reduce a recording's table to figures; `gyro_scale` as in `errors_of`."""
    errors = errors_of(windows, gyro_scale)
    ok = windows["ok"]
    moving, still = windows["moved_px"] >= MOVING_PX, windows["moved_px"] < MOVING_PX
    flow = np.isfinite(windows["epe_px"])
    epe, way = _mean(windows["epe_px"][flow]), _mean(windows["truth_px"][flow])
    judged = ok & np.isfinite(errors.w)
    w_rms, w_true_rms = _rms(errors.w[judged]), _rms(errors.w_true[judged])
    parallax = ok & (windows["parallax_px"] > PARALLAX_PX)
    given = np.isfinite(windows["linear"]).all(axis=1)
    v = errors.v[parallax & np.isfinite(errors.v)]
    lost = windows["epe_px"] > LOST_SHARE * windows["truth_px"]
    return Figures(
        **vars(scores_of(windows, errors.w_scale)),
        windows=len(windows),
        estimates=int(ok.sum()),
        moving=int(moving.sum()),
        still=int(still.sum()),
        covered_moving=_share(ok[moving]),
        covered_still=_share(ok[still]),
        flow_moving=_share(flow[moving]),
        epe_px=epe,
        truth_px=way,
        epe_percent=_percent(epe, way),
        w_rms=w_rms,
        w_true_rms=w_true_rms,
        w_percent=_percent(w_rms, w_true_rms),
        w_raw_rms=_rms(errors.w_raw[judged]),
        w_scale=errors.w_scale,
        v_median=_over(np.median, v),
        v_90=_over(lambda values: np.quantile(values, 0.9), v),
        v_reversed=_share(v > _REVERSED_DEG),
        v_windows=len(v),
        v_given=_share(given[parallax]),
        nees_w=_mean(errors.w_nees[np.isfinite(errors.w_nees)]),
        nees_v=_mean(errors.v_nees[np.isfinite(errors.v_nees)]),
        confident_wrong=_share((errors.w_wrong | errors.v_wrong)[ok]),
        confident_wrong_w=_share(errors.w_wrong[ok]),
        confident_wrong_v=_share(errors.v_wrong[ok]),
        lost=_share(lost[moving & flow]),
        still_wrong=_share(errors.still_wrong[still]),
        settled_s=_settled(windows, errors.w, max(W_DEG_S, W_SHARE * w_true_rms)),
        window_ms=1e3 * _over(np.median, windows["seconds"]),
    )


def _best_scale(estimated: Values, true: Values, largest: float) -> float:
    """Least-squares factor from the truth to the estimates, kept within [1, largest]."""
    known = np.isfinite(estimated).all(axis=1) & np.isfinite(true).all(axis=1)
    power = float((true[known] ** 2).sum())
    if power == 0:
        return 1.0
    return float(np.clip((estimated[known] * true[known]).sum() / power, 1.0, largest))


def _settled(windows: Windows, w: Values, bound: float) -> float:
    """Longest time of a start (s) until the end of the first window from which w stays good."""
    times = []
    for start in np.unique(windows["start"]):
        chosen = np.flatnonzero((windows["start"] == start) & np.isfinite(w))
        bad = np.flatnonzero(~(w[chosen] <= bound))
        first = int(bad[-1]) + 1 if len(bad) else 0
        if first == len(chosen):
            return math.inf
        row = windows[chosen[first]]
        times.append(float(row["t_end"] - row["t_begin"]) / 1e9)
    return max(times, default=math.nan)


def _over(statistic: Callable[[Values], Any], values: Values) -> float:
    return float(statistic(values)) if len(values) else math.nan


def _mean(values: Values) -> float:
    return _over(np.mean, values)


def _rms(values: Values) -> float:
    return math.sqrt(_over(np.mean, values**2))


def _share(mask: Mask) -> float:
    """Share of true values, percent."""
    return 100.0 * _over(np.mean, mask.astype(np.float64))


def _percent(part: float, whole: float) -> float:
    return 100.0 * part / whole if whole > 0 else math.nan
