"""A window whose motion changes more than the fit can follow is shortened to its latest part."""

from dataclasses import replace

import numpy as np
import pytest
from moving_paths import CAMERA, MS, START, ExactEstimator, Path, policy

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.motion_windows import MotionChange, MotionWindows
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.core.types.gyro import GyroReadings

LATTICE = Lattice.with_spacing(346, 260, 26.0)
CHANGE = MotionChange(Contrast(LATTICE, 0.25))


@pytest.mark.parametrize(
    ("change_px", "way_px", "count", "steady"),
    [
        (1.5, 60.0, 20_000, 20_000),
        (4.0, 60.0, 20_000, 10_000),  # to a change of 1 px, which grows with the square of the time
        (16.0, 60.0, 20_000, 5_000),
        (16.0, 12.0, 20_000, 10_000),  # 6 px are left
        (16.0, 5.0, 20_000, 20_000),
        (16.0, 0.0, 20_000, 20_000),
        (16.0, 60.0, 8_000, 3_000),
        (16.0, 60.0, 2_000, 2_000),
    ],
)
def test_how_many_events_show_a_motion_that_a_fit_can_follow(change_px, way_px, count, steady):
    flow = np.zeros(LATTICE.shape, np.float32)
    flow[:] = way_px * np.array([0.6, 0.8], np.float32)
    assert CHANGE.steady(change_px, flow, count) == steady


def test_the_part_that_was_estimated_tells_how_long_the_next_one_is():
    """Of 1000 events over 20 px the estimator takes the later half; 8 of its 10 px are next."""

    class Shortening(ExactEstimator):
        def estimate(self, window):
            return super().estimate(window.latest(len(window.events) // 2))

    inner = Shortening(path := Path([200.0] * 3))
    estimator = MotionWindows(inner, CAMERA, policy(bound=8.0, min_count=50))
    window = Window(START, START + 100 * MS, path.events[:1000])
    estimator.estimate(window)
    estimator.estimate(window)
    assert [len(w.events) for w in inner.windows] == [500, 200]


TURNS_S, RATE = 0.16, 1.0  # rad/s
DAVIS = Camera(346, 260, 300.0, 300.0, 172.5, 129.5)


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    """Dots before a camera that turns about its y axis, and back from 0.16 s on."""
    rng = np.random.default_rng(1)
    t = np.sort(rng.integers(0, 200 * MS, 60_000))
    dots = rng.uniform([-0.6, -0.4], [0.6, 0.4], (150, 2))[rng.integers(0, 150, len(t))]
    seconds = t * 1e-9
    angle = RATE * np.minimum(seconds, 2 * TURNS_S - seconds)
    across = np.arctan(dots[:, 0]) - angle
    x = np.round(DAVIS.fx * np.tan(across) + DAVIS.cx)
    y = np.round(DAVIS.fy * dots[:, 1] / (np.cos(across) * np.hypot(1, dots[:, 0])) + DAVIS.cy)
    inside = (x >= 0) & (x < 346) & (y >= 0) & (y < 260)
    events = Events(
        x[inside].astype(np.uint16),
        y[inside].astype(np.uint16),
        START + t[inside],
        np.ones(inside.sum(), np.bool_),
    )
    half = int(np.searchsorted(events.t, START + 100 * MS))
    return [
        Window(START, START + 100 * MS, events[:half]),
        Window(START + 100 * MS, START + 200 * MS, events[half:]),
    ]


def test_of_a_window_in_which_the_camera_turns_back_its_latest_part_is_estimated(windows):
    estimator = LatticeEstimator(DAVIS, LatticeConfig(), whole=False)
    first, second = (estimator.estimate(window) for window in windows)
    assert first.t_start == windows[0].t_start
    assert first.angular == pytest.approx([0, RATE, 0], abs=0.05)
    assert START + 160 * MS < second.t_start < START + 185 * MS
    assert second.t_end == windows[1].t_end
    assert second.angular == pytest.approx([0, -RATE, 0], abs=0.1)


def test_windows_that_are_to_be_taken_whole_are(windows):
    estimator = LatticeEstimator(DAVIS, LatticeConfig())
    told = [estimator.estimate(window) for window in windows]
    assert [estimate.t_start for estimate in told] == [window.t_start for window in windows]


def test_a_first_window_is_estimated_whole(windows):
    """Nothing tells yet what its motion is."""
    estimator = LatticeEstimator(DAVIS, LatticeConfig(), whole=False)
    assert estimator.estimate(windows[1]).t_start == windows[1].t_start


def test_with_a_gyro_a_window_is_estimated_whole(windows):
    """It tells how w changes within the window."""
    estimator = LatticeEstimator(DAVIS, LatticeConfig(), whole=False)
    t = START + np.arange(-5, 206) * MS
    w = np.where(t < START + TURNS_S * 1e9, RATE, -RATE)[:, None] * np.array([0.0, 1.0, 0.0])
    readings = GyroReadings(t, w)
    told = [estimator.estimate(replace(window, gyro=readings)) for window in windows]
    assert [estimate.t_start for estimate in told] == [window.t_start for window in windows]
