"""The flow fitted again with a known motion: nearer to the truth, and the fit stays as it is."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.estimate import Estimate, MotionModel
from emoflow_ros.core.events import Window, WindowSlicer
from emoflow_ros.core.lattice_estimator import LatticeEstimator
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

CONFIG = load_config()
SURE = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])  # of (v, w)


@dataclass(frozen=True)
class Known:
    """The true motion (a Motion)."""

    recording: SimulatedRecording

    def angular(self, t: int) -> np.ndarray:
        return self.recording.truth.twist(t)[1]

    def linear(self, t: int) -> np.ndarray:
        v = self.recording.truth.twist(t)[0]
        return v / max(float(np.linalg.norm(v)), 1e-9)


def windows_of(scene: str) -> tuple[SimulatedRecording, list[Window]]:
    recording = simulate(scene, duration_s=0.6, seed=4, fps=500)
    return recording, WindowSlicer(CONFIG.window).push(recording.events)


def told(recording: SimulatedRecording, found: Estimate) -> Estimate:
    motion = Known(recording)
    linear = motion.linear(found.t)
    across = SURE.copy()
    across[:3, :3] = 1e-4 * (np.eye(3) - np.outer(linear, linear))
    angular = motion.angular(found.t)
    return replace(
        found,
        model=MotionModel.FULL,
        linear=linear,
        angular=angular,
        covariance=across,
        motion=motion,
    )


def error(recording: SimulatedRecording, estimate: Estimate) -> float:
    assert estimate.flow is not None
    apart = estimate.flow.velocity(estimate.t) - recording.truth.flow(estimate.t)
    return float(np.nanmean(np.linalg.norm(apart, axis=-1)))


@pytest.mark.parametrize("scene", ["calm", "forward"])
def test_with_the_true_motion_the_flow_comes_nearer_to_the_truth(scene):
    recording, windows = windows_of(scene)
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    before, after = [], []
    for window in windows:
        found = estimator.estimate(window)
        flow = estimator._fit.flow
        again = estimator.refined(told(recording, found))
        assert estimator._fit.flow is flow
        before.append(error(recording, found))
        after.append(error(recording, again))
    assert np.mean(after[2:]) < 0.96 * np.mean(before[2:])


def test_a_flow_that_cannot_be_fitted_stays_as_it_was():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    found = estimator.estimate(windows[0])
    lost = told(recording, found)
    lost = replace(lost, covariance=np.full((6, 6), np.nan))
    assert estimator.refined(lost).flow is found.flow
