"""What the benchmarks prescribe per sequence: calibration, frames, segment and crop."""

from dataclasses import dataclass
from typing import Any

from emoflow_ros.core.camera import Camera
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
class Sequence:
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


def _outdoor(name: str, **limits: Any) -> Sequence:
    return Sequence(name, _OUTDOOR, rows=_HOOD, clip_events=_OUTDOOR_CLIP, **limits)


def _dsec(name: str) -> Sequence:
    return Sequence(name, None, clip_events=DSEC_CLIP, topic=None)


# The training sequences of DSEC that have flow truth.
_DSEC_WITH_TRUTH = (
    "thun_00_a",
    *(f"zurich_city_{name}" for name in ("01_a", "02_a", "02_c", "02_d", "02_e", "03_a", "05_a")),
    *(f"zurich_city_{name}" for name in ("05_b", "06_a", "07_a", "08_a", "09_a", "10_a", "10_b")),
    *(f"zurich_city_{name}" for name in ("11_a", "11_b", "11_c")),
)

_TABLE = (
    Sequence("indoor_flying1", _INDOOR, 60, 1340),
    Sequence("indoor_flying2", _INDOOR, 140, 1500),
    Sequence("indoor_flying3", _INDOOR, 100, 1711),
    Sequence("indoor_flying4", _INDOOR, 104, 380),
    _outdoor("outdoor_day1", last_frame=5020),
    _outdoor("outdoor_day1_segment", segment_s=(222.4, 240.4)),
    _outdoor("outdoor_day2", last_frame=5020),
    # The sequences of DSEC's flow benchmark.
    _dsec("interlaken_00_b"),
    _dsec("interlaken_01_a"),
    _dsec("thun_01_a"),
    _dsec("thun_01_b"),
    _dsec("zurich_city_12_a"),
    _dsec("zurich_city_14_c"),
    _dsec("zurich_city_15_a"),
    *map(_dsec, _DSEC_WITH_TRUTH),
)
SEQUENCES = {sequence.name: sequence for sequence in _TABLE}


def find_sequence(name: str) -> Sequence:
    """Look a sequence up.

    Raises:
        InputError: no such sequence.
    """
    if name not in SEQUENCES:
        raise InputError(
            "--sequence", f"unknown sequence '{name}'", f"use one of {', '.join(SEQUENCES)}"
        )
    return SEQUENCES[name]
