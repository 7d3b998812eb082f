"""Speeds of successive adjustments, each with a unit of length of its own, in one unit."""

import numpy as np
import pytest

from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.trajectory import AdjustedMotion
from emoflow_ros.core.geometry.camera_motion import SplineMotion
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS
from emoflow_ros.evaluation.relative_speed import RelativeSpeed

STEP = 50 * NS_PER_MS
NODES = 12


def position(t):
    """Along z at 1, 2, 3... m/s: speeds up by 1 m/s in a second."""
    s = np.asarray(t) / 1e9
    return s + 0.5 * s**2


def adjusted(first: int, unit: float, translates: bool = True) -> AdjustedMotion:
    """An adjustment over twelve nodes; its unit of length has so many metres."""
    times = (first + np.arange(NODES)) * STEP
    place, velocity = np.zeros((NODES, 3)), np.zeros((NODES, 3))
    place[:, 2] = (position(times) - position(times[-1])) / unit
    velocity[:, 2] = (1 + times / 1e9) / unit
    x = Unknowns(
        np.tile(np.eye(3), (NODES, 1, 1)), place, np.zeros((NODES, 3)), velocity, np.zeros(0)
    )
    return AdjustedMotion(times, x, translates, SplineMotion(0, 1, *np.zeros((2, 4, 3))))


def estimate(motion: object, t: int) -> Estimate:
    quality = Quality(events=1)
    return Estimate(t, t, t, Status.OK, quality, model=MotionModel.FULL, motion=motion)  # type: ignore[arg-type]


def follow(pace: RelativeSpeed, first: int, unit: float, *, translates: bool = True) -> float:
    motion = adjusted(first, unit, translates)
    return pace.follow(estimate(motion, int(motion.times[-2])))


def true_speed(first: int) -> float:
    return 1 + (first + NODES - 2) * STEP / 1e9


def test_speeds_are_in_the_first_unit_however_units_change():
    pace = RelativeSpeed()
    found = [follow(pace, first, unit) for first, unit in ((0, 2.0), (3, 0.7), (6, 5.0), (16, 1.3))]
    np.testing.assert_allclose(found, [true_speed(first) / 2.0 for first in (0, 3, 6, 16)])


@pytest.mark.parametrize("between", [None, "no motion", "rotation"])
def test_a_memory_that_begins_anew_goes_on_as_fast(between):
    pace = RelativeSpeed()
    before = follow(pace, 0, 2.0)
    if between == "no motion":
        assert np.isnan(pace.follow(estimate(None, 0)))
    if between == "rotation":
        assert np.isnan(follow(pace, 2, 2.0, translates=False))
    after = follow(pace, 40, 0.5)
    assert after == pytest.approx(before)
    later = follow(pace, 43, 3.0)
    assert later / after == pytest.approx(true_speed(43) / true_speed(40))
