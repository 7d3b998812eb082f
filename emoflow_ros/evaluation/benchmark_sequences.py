"""What the benchmarks prescribe per sequence, and what the method's paper published for it.

The paper is arXiv 2510.12753.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.errors import InputError

# MVSEC's left DAVIS346 (camchain of the two sites; the published code of several methods uses
# the right one's for indoor_flying).
_INDOOR = Camera(
    346,
    260,
    226.38018519795807,
    226.15002947047415,
    173.6470807871759,
    133.73271487507847,
    "equidistant",
    (-0.048031442223833355, 0.011330957517194437, -0.055378166304281135, 0.021500973881459395),
)
_OUTDOOR = Camera(
    346,
    260,
    223.9940010790056,
    223.61783486959376,
    170.7684322973841,
    128.18711828338436,
    "equidistant",
    (-0.033904378348448685, -0.01537260902537579, -0.022284741346941413, 0.0069204143687187645),
)
_HOOD = 193  # the car's hood begins here
MVSEC_CLIP = 30_000
_OUTDOOR_CLIP = 40_000
DSEC_CLIP = 1_500_000


@dataclass(frozen=True)
class BenchmarkSequence:
    """One sequence of a benchmark.

    Attributes:
        name: as the data set calls it.
        camera: the left camera; None where every recording brings its own calibration.
        first_frame, last_frame: the frames that evaluation intervals start at, inclusive;
            None means no limit.
        segment_s: limits (from, to) of the evaluated part, in s since the first frame.
        rows: the image rows above this one count; None means all.
        clip_events: events of one window in the published runs.
        topic: the left camera's events in the data set's bags.
    """

    name: str
    camera: Camera | None
    first_frame: int = 0
    last_frame: int | None = None
    segment_s: tuple[float, float] | None = None
    rows: int | None = None
    clip_events: int = MVSEC_CLIP
    topic: str | None = "/davis/left/events"


def _outdoor_sequence(name: str, **limits: Any) -> BenchmarkSequence:
    return BenchmarkSequence(name, _OUTDOOR, rows=_HOOD, clip_events=_OUTDOOR_CLIP, **limits)


def _dsec_sequence(name: str) -> BenchmarkSequence:
    return BenchmarkSequence(name, None, clip_events=DSEC_CLIP, topic=None)


# The training sequences of DSEC that have flow truth.
_DSEC_WITH_TRUTH = (
    "thun_00_a",
    *(f"zurich_city_{name}" for name in ("01_a", "02_a", "02_c", "02_d", "02_e", "03_a", "05_a")),
    *(f"zurich_city_{name}" for name in ("05_b", "06_a", "07_a", "08_a", "09_a", "10_a", "10_b")),
    *(f"zurich_city_{name}" for name in ("11_a", "11_b", "11_c")),
)

_TABLE = (
    BenchmarkSequence("indoor_flying1", _INDOOR, 60, 1340),
    BenchmarkSequence("indoor_flying2", _INDOOR, 140, 1500),
    BenchmarkSequence("indoor_flying3", _INDOOR, 100, 1711),
    BenchmarkSequence("indoor_flying4", _INDOOR, 104, 380),
    _outdoor_sequence("outdoor_day1", last_frame=5020),
    _outdoor_sequence("outdoor_day1_segment", segment_s=(222.4, 240.4)),
    _outdoor_sequence("outdoor_day2", last_frame=5020),
    # The sequences of DSEC's flow benchmark.
    _dsec_sequence("interlaken_00_b"),
    _dsec_sequence("interlaken_01_a"),
    _dsec_sequence("thun_01_a"),
    _dsec_sequence("thun_01_b"),
    _dsec_sequence("zurich_city_12_a"),
    _dsec_sequence("zurich_city_14_c"),
    _dsec_sequence("zurich_city_15_a"),
    *map(_dsec_sequence, _DSEC_WITH_TRUTH),
)

SEQUENCES = {sequence.name: sequence for sequence in _TABLE}


def find_sequence(name: str) -> BenchmarkSequence:
    """Look a sequence up.

    Raises:
        InputError: no such sequence.
    """
    if name not in SEQUENCES:
        raise InputError(
            "--sequence", f"unknown sequence '{name}'", f"use one of {', '.join(SEQUENCES)}"
        )
    return SEQUENCES[name]


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


_MVSEC_CONDITIONS = (
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

_DSEC_CONDITIONS = (
    "The figure is the benchmark server's, over the pixels of the test sequence with truth and "
    "displacements over 100 ms; the truth of test sequences is not public.",
)


def _mvsec_figures(figures: tuple[float, ...], early_stopping: tuple[float, ...] = ()) -> Published:
    """EPE in px, RMS of w in deg/s, RMS of v in m/s and ms per window, as far as published."""
    keys = ("epe_px", "paper_angular_rms_deg_s", "paper_linear_rms_m_s", "runtime_p50_ms")
    stopped = ("epe_px", "paper_angular_rms_deg_s", "runtime_p50_ms")
    return Published(
        dict(zip(keys, figures, strict=False)),
        _MVSEC_CONDITIONS,
        dict(zip(stopped, early_stopping, strict=False)),
    )


def _dsec_figures(epe_px: float) -> Published:
    return Published({"epe_px": epe_px}, _DSEC_CONDITIONS)


PUBLISHED: Mapping[str, Published] = {
    "indoor_flying1": _mvsec_figures((1.56, 3.44, 0.11, 9300), (1.61, 5.32, 4210)),
    "indoor_flying2": _mvsec_figures((2.04, 5.31, 0.12, 9410), (2.09, 5.77, 4300)),
    "indoor_flying3": _mvsec_figures((1.84, 4.12, 0.15, 9500), (1.90, 4.94, 4780)),
    "indoor_flying4": _mvsec_figures((2.38, 5.10)),
    "outdoor_day1_segment": _mvsec_figures((1.61, 3.38, 0.76, 10770), (1.68, 5.22, 4560)),
    "outdoor_day2": _mvsec_figures((3.49, 5.76)),
    "interlaken_00_b": _dsec_figures(7.31),
    "interlaken_01_a": _dsec_figures(3.55),
    "thun_01_a": _dsec_figures(3.60),
    "thun_01_b": _dsec_figures(2.99),
    "zurich_city_12_a": _dsec_figures(3.28),
    "zurich_city_14_c": _dsec_figures(4.43),
    "zurich_city_15_a": _dsec_figures(2.90),
}
