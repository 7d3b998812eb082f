"""Whether a recording's figures are accurate, and whether consistent, by named criteria."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from benchmarks.scoreboard.figures import W_DEG_S, W_SHARE, Figures

COVERAGE_PERCENT = 90.0
EPE_PX = 0.7
EPE_SHARE = 0.09
V_DEG = 8.0
NEES = (0.3, 3.0)
CONFIDENT_PERCENT = 1.0

ACCURATE = ("coverage", "epe", "w", "v")
CONSISTENT = ("answer", "still", "nees", "confident", "lost")
CRITERIA = ACCURATE + CONSISTENT

# True, False, or None where nothing in the recording can be judged by it.
Criterion = bool | None


@dataclass(frozen=True)
class Verdict:
    """The criteria of one recording by name (see CRITERIA), and what follows.

    A criterion that cannot be judged does not count against the recording.
    """

    criteria: Mapping[str, Criterion]

    @property
    def accurate(self) -> bool:
        """No criterion of ACCURATE is missed."""
        return all(self.criteria[name] is not False for name in ACCURATE)

    @property
    def consistent(self) -> bool:
        """No criterion of CONSISTENT is missed."""
        return all(self.criteria[name] is not False for name in CONSISTENT)

    @property
    def missed(self) -> list[str]:
        """Names of the criteria that are missed."""
        return [name for name in CRITERIA if self.criteria[name] is False]


def judge(figures: Figures) -> Verdict:
    """Judge one recording.

    Accurate: `coverage`, an estimate in at least 90 % of the moving windows; `epe`, at most 0.7 px
    or 9 % of the displacement, whichever is larger; `w`, RMS error at most 2.5 deg/s or 8 % of
    RMS |w|, whichever is larger; `v`, median error at most 8 degrees where the true parallax
    exceeds 2 px. Estimates there of which none gives v miss it.

    Consistent: `answer`, an estimate at all where anything moves: silence has no covariance that
    could be wrong; `still`, no estimate while nothing moves, or one that its covariance covers;
    `nees`, mean NEES of w and of v between 0.3 and 3; `confident`, confident and wrong in at most
    1 % of the windows with an estimate; `lost`, in no moving window with an estimate is the EPE
    above half of the displacement.
    """
    f = figures
    v = _at_most(f.v_median, V_DEG)
    if v is None and f.v_given == 0:
        v = False
    return Verdict(
        {
            "coverage": _at_least(f.covered_moving, COVERAGE_PERCENT),
            "epe": _at_most(f.epe_px, max(EPE_PX, EPE_SHARE * f.truth_px)),
            "w": _at_most(f.w_rms, max(W_DEG_S, W_SHARE * f.w_true_rms)),
            "v": v,
            "answer": f.estimates > 0 if f.moving else None,
            "still": _at_most(f.still_wrong, 0.0),
            "nees": _all([_within(f.nees_w, NEES), _within(f.nees_v, NEES)]),
            "confident": _at_most(f.confident_wrong, CONFIDENT_PERCENT),
            "lost": _at_most(f.lost, 0.0),
        }
    )


def rate(outcomes: Sequence[Criterion]) -> float:
    """Share of those that can be judged which are met, percent; NaN without any."""
    judged = [outcome for outcome in outcomes if outcome is not None]
    return 100.0 * sum(judged) / len(judged) if judged else math.nan


def _at_most(value: float, bound: float) -> Criterion:
    return None if math.isnan(value) else value <= bound


def _at_least(value: float, bound: float) -> Criterion:
    return None if math.isnan(value) else value >= bound


def _within(value: float, bounds: tuple[float, float]) -> Criterion:
    return None if math.isnan(value) else bounds[0] <= value <= bounds[1]


def _all(outcomes: Sequence[Criterion]) -> Criterion:
    judged = [outcome for outcome in outcomes if outcome is not None]
    return all(judged) if judged else None
