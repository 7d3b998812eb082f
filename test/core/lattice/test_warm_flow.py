"""Starts of warm windows and lost flow, on points that move together."""

import numpy as np
import pytest

from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.flow_starts import best_start, fresh_start, is_lost
from emoflow_ros.core.lattice.window_events import WindowEvents

LATTICE = Lattice.with_spacing(160, 120, 26.0)
MOVED = np.array([12.0, -7.0], np.float32)


@pytest.fixture(scope="module")
def events() -> WindowEvents:
    """200 points, 20 events each along their way of 14 px, noise of half a pixel."""
    rng = np.random.default_rng(3)
    s = rng.uniform(0, 1, 4000).astype(np.float32)
    order = np.argsort(s)
    points = np.repeat(rng.uniform([15, 15], [145, 105], (200, 2)), 20, axis=0)
    x, y = (points + (s[:, None] - 0.5) * MOVED + rng.normal(0, 0.5, (4000, 2))).T
    on = np.repeat(rng.random(200) < 0.5, 20)
    return WindowEvents.prepare(
        *(column[order].astype(np.float32) for column in (x, y, s)), on[order]
    )


@pytest.fixture(scope="module")
def coarse() -> Contrast:
    return Contrast(LATTICE, 0.25)


def constant(*flow: float) -> np.ndarray:
    return np.zeros(LATTICE.shape, np.float32) + np.array(flow, np.float32)


def test_the_start_is_the_flow_that_sharpens_best(events, coarse):
    flows = [constant(0, 0), constant(*MOVED), constant(*-MOVED), constant(24, -14)]
    assert best_start(coarse, events, flows) is flows[1]


@pytest.mark.parametrize("wrong", [(0, 0), (-12, 7), (12, 7)])
def test_a_flow_in_the_wrong_maximum_is_lost(events, coarse, wrong):
    assert is_lost(coarse, events, constant(*wrong), fresh_start(coarse, events, LATTICE.shape))


@pytest.mark.parametrize("off", [(0, 0), (0.7, -0.7)])
def test_the_right_flow_is_not_lost(events, coarse, off):
    fresh = fresh_start(coarse, events, LATTICE.shape)
    assert not is_lost(coarse, events, constant(*(MOVED + np.array(off))), fresh)
