"""After which windows the next one starts warm."""

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.lattice.egomotion import Motion
from emoflow_ros.core.lattice.known import Structure
from emoflow_ros.core.lattice.memory import Memory
from emoflow_ros.core.types.estimate import MotionModel
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window

MS = NS_PER_MS
NOTHING = Structure(np.zeros(4), np.zeros(4))


def memory(start_ms: float, end_ms: float) -> Memory:
    flow = np.zeros((2, 2, 2, 2), np.float32)
    still = Motion.constant(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    return Memory(round(start_ms * MS), round(end_ms * MS), flow, still, NOTHING, MotionModel.FULL)


def window(start_ms: float, end_ms: float) -> Window:
    return Window(round(start_ms * MS), round(end_ms * MS), Events.empty())


@pytest.mark.parametrize("times", [1, 2, 5, 10])
@pytest.mark.parametrize("part_ms", [20, 60, 135])
def test_windows_dropped_by_overload_leave_the_next_one_warm(times, part_ms):
    """Of every so many windows of the default profile one is estimated, its latest part only."""
    policy = load_config().window
    end = 1000 + policy.duration_ms
    later = end + times * policy.stride_ms
    assert memory(end - part_ms, end).reaches(window(later - part_ms, later))


def test_silence_of_more_than_nine_tenths_of_a_second_and_a_step_back_start_cold():
    last = memory(0, 100)
    assert last.reaches(window(1000, 1100))
    assert not last.reaches(window(1001, 1101))
    assert not last.reaches(window(-50, 99))
