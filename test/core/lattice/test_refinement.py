"""The flow fitted again with a known motion: nearer to the truth, and the fit stays as it is."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera_motion import motion_field
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.refinement import Depths
from emoflow_ros.core.types.estimate import Estimate, MotionModel
from emoflow_ros.core.types.events import Window, WindowSlicer
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

CONFIG = load_config()
NONE = Depths(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
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
        again, _ = estimator.refined(told(recording, found), NONE)
        assert estimator._fit.flow is flow
        before.append(error(recording, found))
        after.append(error(recording, again))
    assert np.mean(after[2:]) < 0.96 * np.mean(before[2:])


def test_the_next_window_starts_from_the_flow_that_was_fitted_again():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    found = estimator.estimate(windows[0])
    before = estimator._last
    again, _ = estimator.refined(told(recording, found), NONE)
    after = estimator._last
    assert before is not None and after is not None and again.flow is not None
    assert (before.flow == estimator._fit.flow).all()
    assert after.flow == pytest.approx(again.flow.values)
    assert np.abs(after.flow - before.flow).max() > 0.1
    assert after.motion is before.motion


def test_a_flow_that_cannot_be_fitted_stays_as_it_was():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    found = estimator.estimate(windows[0])
    lost = told(recording, found)
    lost = replace(lost, covariance=np.full((6, 6), np.nan))
    assert estimator.refined(lost, NONE)[0].flow is found.flow
    assert estimator.refined(lost, true_depths(recording, found.t))[0].flow is found.flow


def test_before_any_fit_no_flow_is_fitted_again():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    found = estimator.estimate(windows[0])
    fresh = LatticeEstimator(recording.camera, CONFIG.estimator)
    assert fresh.refined(told(recording, replace(found, flow=None)), NONE)[0].flow is None


def true_depths(recording: SimulatedRecording, t: int) -> Depths:
    """Depths at some pixels, by the true flow: what rotation leaves of it, over the matrix A v."""
    rng = np.random.default_rng(0)
    points = rng.uniform(10, np.array(recording.camera.size) - 10, (200, 2)).round()
    flow = recording.truth.flow(t)[points[:, 1].astype(int), points[:, 0].astype(int)]
    a, b = motion_field(recording.camera, points)
    linear, angular = Known(recording).linear(t), Known(recording).angular(t)
    line = a @ linear
    rho = ((flow - b @ angular) * line).sum(axis=1) / (line**2).sum(axis=1)
    known = np.isfinite(rho)
    return Depths(points[known], rho[known], np.ones(known.sum()))


def test_depths_that_are_known_help():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    without, with_them = [], []
    for window in windows:
        found = told(recording, estimator.estimate(window))
        depths = true_depths(recording, found.t)
        without.append(error(recording, estimator.refined(found, NONE)[0]))
        with_them.append(error(recording, estimator.refined(found, depths)[0]))
    assert np.mean(with_them[2:]) < 0.9 * np.mean(without[2:])


def test_a_flow_that_is_lost_is_found_again_by_the_known_motion():
    recording, windows = windows_of("rotation")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    before, after = [], []
    for window in windows:
        found = told(recording, estimator.estimate(window))
        found = replace(found, model=MotionModel.ROTATION, linear=np.zeros(3))
        right = error(recording, estimator.refined(found, NONE)[0])
        estimator._fit.flow = estimator._fit.flow + np.float32(12.0)  # px, everywhere
        before.append(right)
        after.append(error(recording, estimator.refined(found, NONE)[0]))
        estimator.reset()
    assert np.mean(after) == pytest.approx(np.mean(before), rel=0.05)


def test_where_a_window_shows_no_flow_the_rigid_scene_has_one():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    for window in windows[:3]:
        found = estimator.estimate(window)
    estimator._fit.motion = None  # as after a cold start that finds nothing
    none = told(recording, replace(found, flow=None))
    again, _ = estimator.refined(none, true_depths(recording, found.t))
    assert error(recording, again) < 0.9 * error(recording, found)
    assert estimator.refined(none, NONE)[0].flow is None


def test_a_flow_shows_the_depths_of_the_scene():
    recording, windows = windows_of("calm")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    for window in windows[:3]:
        found = told(recording, estimator.estimate(window))
    _, shown = estimator.refined(found, NONE)
    assert shown is not None and shown.t == (found.t_start + found.t_end) // 2
    motion = Known(recording)
    linear, angular = 0.5 * motion.linear(shown.t), motion.angular(shown.t)  # in another unit
    depth, information, static = shown.inverse_depths(angular, linear)
    nodes = estimator.lattice.pixels.round().astype(int)
    line = shown.epipolar.a @ linear
    along = recording.truth.flow(shown.t)[nodes[:, 1], nodes[:, 0]] - shown.epipolar.b @ angular
    true = (along * line).sum(axis=1) / (line**2).sum(axis=1)
    known = information > np.median(information)
    apart = (depth - true)[known]
    assert np.median(np.abs(apart) / true[known]) < 0.1
    assert 0.1 < np.median(np.abs(apart) * np.sqrt(information[known])) < 2
    assert np.median(static) > 0.9


def test_a_rotation_shows_no_depths():
    recording, windows = windows_of("rotation")
    estimator = LatticeEstimator(recording.camera, CONFIG.estimator)
    found = told(recording, estimator.estimate(windows[0]))
    found = replace(found, model=MotionModel.ROTATION, linear=np.zeros(3))
    assert estimator.refined(found, NONE)[1] is None
