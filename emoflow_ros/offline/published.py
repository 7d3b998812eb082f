"""The published figures of the method (arXiv 2510.12753), and what they hold under."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Published:
    """The paper's figures for one sequence.

    Attributes:
        figures: by the key of the measure that is counted in the same way.
        conditions: what they hold under, one sentence each.
        early_stopping: the figures with early stopping, where they are published.
    """

    figures: Mapping[str, float]
    conditions: tuple[str, ...]
    early_stopping: Mapping[str, float] = field(default_factory=dict)


_MVSEC = (
    "Each window runs from a frame to the 4th one after it (dt=4) and is fitted to 30 000 events "
    "(40 000 outdoors), also from outside the window, from a cold start with 1000 iterations "
    "or, with early stopping, fewer.",
    "RMS errors are taken per window, then averaged over windows, against the smoothed velocities "
    "of MVSEC's *_odom.npz.",
    "The error of v takes the magnitude and the sign of every axis from the truth: it says nothing "
    "about the direction, and compares with the row marked 'paper' alone.",
    "The warp is a single Euler step; the epipolar constraint leaves lens distortion out and, "
    "indoors, uses the intrinsics of the right camera.",
    "Times are means per window on an RTX 4090, without reading and evaluation.",
)
_DSEC = (
    "The figure is the benchmark server's, over the pixels of the test sequence with truth and "
    "displacements over 100 ms; the truth of test sequences is not public.",
)


def _mvsec(figures: tuple[float, ...], early_stopping: tuple[float, ...] = ()) -> Published:
    """EPE in px, RMS of w in deg/s, RMS of v in m/s and s per window, as far as published."""
    keys = ("epe_px", "paper_angular_rms_deg_s", "paper_linear_rms_m_s", "runtime_p50_ms")
    stopped = ("epe_px", "paper_angular_rms_deg_s", "runtime_p50_ms")
    return Published(
        dict(zip(keys, figures, strict=False)),
        _MVSEC,
        dict(zip(stopped, early_stopping, strict=False)),
    )


def _dsec(epe_px: float) -> Published:
    return Published({"epe_px": epe_px}, _DSEC)


PUBLISHED: Mapping[str, Published] = {
    "indoor_flying1": _mvsec((1.56, 3.44, 0.11, 9300), (1.61, 5.32, 4210)),
    "indoor_flying2": _mvsec((2.04, 5.31, 0.12, 9410), (2.09, 5.77, 4300)),
    "indoor_flying3": _mvsec((1.84, 4.12, 0.15, 9500), (1.90, 4.94, 4780)),
    "indoor_flying4": _mvsec((2.38, 5.10)),
    "outdoor_day1_segment": _mvsec((1.61, 3.38, 0.76, 10770), (1.68, 5.22, 4560)),
    "outdoor_day2": _mvsec((3.49, 5.76)),
    "interlaken_00_b": _dsec(7.31),
    "interlaken_01_a": _dsec(3.55),
    "thun_01_a": _dsec(3.60),
    "thun_01_b": _dsec(2.99),
    "zurich_city_12_a": _dsec(3.28),
    "zurich_city_14_c": _dsec(4.43),
    "zurich_city_15_a": _dsec(2.90),
}
