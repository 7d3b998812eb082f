import numpy as np
import pytest

from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.motion_windows import MotionChange
from emoflow_ros.core.lattice.window_events import WindowEvents

LATTICE = Lattice.with_spacing(346, 260, 26.0)
CHANGE = MotionChange(Contrast(LATTICE, 0.25))


def measured(late_px: float, seed: int, *, turned: bool) -> float:
    """Dots move by 12 px in the window, and by more in a third at its end than the fit knows."""
    rng = np.random.default_rng(seed)
    s = np.sort(rng.random(12_000)).astype(np.float32)
    dots = rng.uniform([40, 40], [300, 220], (100, 2))[rng.integers(0, 100, len(s))]
    way = 12.0 * s + 3 * late_px * np.maximum(s - 2 / 3, 0)
    xy = (dots + np.outer(way, [0.6, 0.8])).astype(np.float32)
    if turned:  # in time: the third at its beginning
        s, xy = 1 - s[::-1], xy[::-1]
    x, y = np.ascontiguousarray(xy.T)
    events = WindowEvents(x, y, np.ascontiguousarray(s), np.ones_like(s))
    flow = np.zeros(LATTICE.shape, np.float32)
    flow[:] = (-1 if turned else 1) * 12.0 * np.array([0.6, 0.8], np.float32)
    return CHANGE.measure(events, flow)


@pytest.mark.parametrize("late_px", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("turned", [False, True])
def test_what_the_last_or_the_first_third_moves_off_the_fit(late_px: float, turned: bool) -> None:
    """One Newton step goes too far by a fifth; single patterns of dots differ by 0.5 px."""
    found = [measured(late_px, seed, turned=turned) for seed in range(8)]
    assert found == pytest.approx([1.2 * late_px] * 8, abs=0.8)
    assert np.mean(found) == pytest.approx(1.2 * late_px, abs=0.35)


def test_a_third_with_few_events_tells_no_change():
    few = [np.full(800, value, np.float32) for value in (100.0, 100.0, 0.5, 1.0)]
    assert CHANGE.measure(WindowEvents(*few), np.zeros(LATTICE.shape, np.float32)) == 0.0
