"""What the memory of positions expects of the next window."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.types.estimate import Estimate, Estimator, Status
from emoflow_ros.core.types.events import NS_PER_MS, Window, WindowSlicer
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

CONFIG = load_config("realtime")


class Listening:
    """Keeps the windows that are estimated, and finds no motion from the third last on."""

    def __init__(self, estimator: Estimator, seen: int) -> None:
        self._estimator, self._seen = estimator, seen
        self.windows: list[Window] = []

    def reset(self) -> None:
        self._estimator.reset()

    def estimate(self, window: Window) -> Estimate:
        self.windows.append(window)
        found = self._estimator.estimate(window)
        if len(self.windows) <= self._seen:
            return found
        return replace(found, flow=None, motion=None, status=Status.NO_MOTION)


@dataclass(frozen=True)
class Heard:
    recording: SimulatedRecording
    reader: RememberingEstimator
    inner: Listening
    windows: list[Window]


@pytest.fixture(scope="module")
def heard() -> Heard:
    recording = simulate("calm", duration_s=1.0, seed=4, fps=500)
    lattice = LatticeEstimator(recording.camera, CONFIG.estimator)
    windows = WindowSlicer(CONFIG.window).push(recording.events)
    inner = Listening(lattice, len(windows) - 3)
    reader = RememberingEstimator(inner, recording.camera, lattice.refined)
    for window in windows:
        reader.estimate(window)
    return Heard(recording, reader, inner, windows)


def test_nothing_is_expected_before_anything_is_adjusted(heard: Heard):
    assert heard.inner.windows[0].expected is None
    assert heard.inner.windows[1].expected is not None  # the first one's slices suffice


@pytest.mark.parametrize("back", [4, 1], ids=["seen", "not seen"])
def test_the_scene_goes_on_as_at_the_newest_node(heard: Heard, back: int):
    window, before = heard.inner.windows[-back], heard.windows[-back - 1]
    assert window.expected is not None
    truth, t = heard.recording.truth, before.t_end
    linear, angular = truth.twist(t)
    width, height = heard.recording.camera.size
    x, y = (f.ravel() for f in np.meshgrid(np.arange(20, width, 20), np.arange(20, height, 20)))
    true = truth.flow(t)[y, x]
    found = window.expected.flow(np.stack([x, y], axis=1).astype(np.float64))
    apart = np.linalg.norm(found - true, axis=1)
    assert np.nanmean(apart) < 0.25 * np.nanmean(np.linalg.norm(true, axis=1))
    assert np.linalg.norm(window.expected.angular - angular) < np.radians(4)
    assert np.linalg.norm(window.expected.linear) == pytest.approx(1)
    assert window.expected.linear @ linear > 0.9 * np.linalg.norm(linear)


@pytest.mark.parametrize("late_ms", [250, 400])
def test_nothing_is_expected_after_a_gap(heard: Heard, late_ms: int):
    """Of more than 300 ms, after which the memory begins anew."""
    last = heard.windows[-1]
    later = last.t_end + late_ms * NS_PER_MS
    window = Window(later - 10 * NS_PER_MS, later, last.events[:0])
    heard.reader.estimate(window)
    assert (heard.inner.windows[-1].expected is None) == (late_ms > 300)
