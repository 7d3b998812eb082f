"""The camera's way over the nodes: which of them are kept."""

import numpy as np
import pytest

from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import superfluous_node

SETTINGS = BackEndSettings()


def kept(step_ms: int, number: int) -> np.ndarray:
    """Times of the nodes after so many slices, ms."""
    times = np.zeros(0, np.int64)
    for k in range(number):
        times = np.append(times, k * step_ms * 10**6)
        while (node := superfluous_node(times, SETTINGS)) is not None:
            times = np.delete(times, node)
    return times // 10**6


@pytest.mark.parametrize("step_ms", [5, 15, 40, 100])
def test_nodes_reach_far_back_where_slices_are_short(step_ms):
    times = kept(step_ms, 200)
    newest = times[-SETTINGS.newest :]
    assert (np.diff(newest) == step_ms).all()
    earlier = np.diff(times[: -SETTINGS.newest])
    apart = -(-round(1e3 * SETTINGS.apart_s) // step_ms) * step_ms
    assert (earlier == apart).all()
    assert len(times) == SETTINGS.slices


def test_nothing_is_forgotten_at_the_start():
    assert superfluous_node(np.arange(SETTINGS.newest + 1) * 10**6, SETTINGS) is None
