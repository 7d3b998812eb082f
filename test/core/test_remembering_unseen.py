"""Windows in which the lattice sees no motion: patches are followed through them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.remembering import Memory, RememberingEstimator
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window, WindowSlicer
from emoflow_ros.simulation.recording import SimulatedRecording, simulate


@dataclass(frozen=True)
class Warm:
    """A memory after six windows, and the next one, of which the lattice tells nothing."""

    recording: SimulatedRecording
    estimator: LatticeEstimator
    memory: Memory
    window: Window
    nothing: Estimate

    def reader(self) -> RememberingEstimator:
        camera, refine = self.recording.camera, self.estimator.refined
        return RememberingEstimator(self.estimator, camera, refine)


@pytest.fixture(scope="module")
def warm() -> Warm:
    recording = simulate("calm", duration_s=0.8, seed=4, fps=500)
    *before, window = WindowSlicer(load_config("realtime").window).push(recording.events)[:7]
    estimator = LatticeEstimator(recording.camera, LatticeConfig())
    reader = RememberingEstimator(estimator, recording.camera, estimator.refined)
    memory = reader.nothing()
    for earlier in before:
        memory, _ = reader.step(memory, earlier, estimator.estimate(earlier))
    found = estimator.estimate(window)
    quality = replace(found.quality, stop_reason=str(Status.NO_MOTION))
    nothing = Estimate(found.t_start, found.t_end, found.t, Status.NO_MOTION, quality)
    return Warm(recording, estimator, memory, window, nothing)


def test_patches_tell_the_motion_and_the_flow_is_fitted_with_it(warm: Warm):
    after, told = warm.reader().step(warm.memory, warm.window, warm.nothing)
    assert (told.status, told.by_events) == (Status.OK, Status.OK)
    assert told.quality.stop_reason == "remembered"
    truth = warm.recording.truth
    angular, flow = truth.twist(told.t)[1], truth.flow(told.t)
    off = np.degrees(np.linalg.norm(told.angular - angular))
    assert off < min(3.0, 0.3 * np.degrees(np.linalg.norm(angular)))
    assert told.flow is not None
    apart = np.linalg.norm(told.flow.velocity(told.t) - flow, axis=-1)
    assert np.nanmean(apart) < 0.3 * np.nanmean(np.linalg.norm(flow, axis=-1))
    newest = int(after.odometry.t[-1])
    assert newest > warm.memory.odometry.t[-1]
    assert told.motion is not None
    later = told.motion.angular(newest + 10 * NS_PER_MS)
    assert later.tolist() == told.motion.angular(newest).tolist()  # nothing tells how it changes


def test_its_distance_to_a_w_that_the_lattice_does_not_measure_does_not_count(warm: Warm):
    _, told = warm.reader().step(warm.memory, warm.window, warm.nothing)
    far = replace(warm.nothing, angular=warm.nothing.angular + 1.0)
    _, same = warm.reader().step(warm.memory, warm.window, far)
    variance = np.trace(told.covariance[3:, 3:])
    assert np.trace(same.covariance[3:, 3:]) == pytest.approx(variance, rel=0.1)


@pytest.mark.parametrize("status", [Status.TOO_FEW_EVENTS, Status.DIVERGED])
def test_a_window_that_says_nothing_at_all_is_passed_on(warm: Warm, status: Status):
    nothing = replace(warm.nothing, status=status)
    after, told = warm.reader().step(warm.memory, warm.window, nothing)
    assert told is nothing
    assert after.odometry is warm.memory.odometry


def test_without_a_memory_it_is_passed_on(warm: Warm):
    reader = warm.reader()
    _, told = reader.step(reader.nothing(), warm.window, warm.nothing)
    assert told is warm.nothing


def test_patches_that_are_lost_leave_the_window_without_a_motion(warm: Warm):
    rng, at = np.random.default_rng(0), warm.window
    t = np.sort(rng.integers(at.t_start, at.t_end, 20_000))
    x, y = (rng.integers(0, n, len(t)).astype(np.uint16) for n in warm.recording.camera.size)
    noise = Window(at.t_start, at.t_end, Events(x, y, t, rng.random(len(t)) < 0.5))
    after, told = warm.reader().step(warm.memory, noise, warm.nothing)
    assert told is warm.nothing
    assert after.odometry is warm.memory.odometry
