"""The estimator with a memory on simulated scenes: accuracy, consistency, determinism, bad days."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import AdjustedMotion
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.products.motion_prior import HeldMotion
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window, WindowSlicer
from emoflow_ros.evaluation.relative_speed import RelativeSpeed
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

CONFIG = load_config("realtime")
SETTLED = 4  # windows: the first 0.4 s


@dataclass(frozen=True)
class Run:
    """A recording, its windows and what is estimated of them."""

    recording: SimulatedRecording
    windows: list[Window]
    estimates: list[Estimate]

    def true_angular(self, t: int) -> np.ndarray:
        return self.recording.truth.twist(t)[1]

    def error(self, e: Estimate) -> float:
        """Error of w, deg/s."""
        return float(np.degrees(np.linalg.norm(e.angular - self.true_angular(e.t))))

    def errors(self) -> tuple[list[float], list[float]]:
        """Errors of w (deg/s) and of the direction of translation (deg), settled windows."""
        w, v = [], []
        for e in self.estimates[SETTLED:]:
            linear = self.recording.truth.twist(e.t)[0]
            w.append(self.error(e))
            unit = linear / np.linalg.norm(linear)
            v.append(float(np.degrees(np.arccos(np.clip(e.linear @ unit, -1, 1)))))
        return w, v


def windows_of(events: Events) -> list[Window]:
    return WindowSlicer(CONFIG.window).push(events)


def estimates_of(recording: SimulatedRecording, windows: list[Window]) -> list[Estimate]:
    estimator = make_estimator(recording.camera, CONFIG)
    return [estimator.estimate(window) for window in windows]


def run_of(scene: str) -> Run:
    recording = simulate(scene, duration_s=0.8, seed=4, fps=500)
    windows = windows_of(recording.events)
    return Run(recording, windows, estimates_of(recording, windows))


@pytest.fixture(scope="module")
def calm() -> Run:
    return run_of("calm")


def test_a_calm_scene_is_estimated_to_a_degree_per_second(calm: Run):
    w, v = calm.errors()
    assert np.median(w) < 1.0
    assert np.median(v) < 3.0
    assert max(w) < 2.5


def test_every_window_has_an_estimate_with_a_covariance_that_holds(calm: Run):
    for e in calm.estimates:
        assert e.status is Status.OK
        error = e.angular - calm.true_angular(e.t)
        assert error @ np.linalg.solve(e.covariance[3:, 3:], error) / 3 < 5
    assert all(e.model is MotionModel.FULL for e in calm.estimates[SETTLED:])


def test_motion_is_continuous_over_the_window(calm: Run):
    motion = calm.estimates[-1].motion
    assert isinstance(motion, HeldMotion) and isinstance(motion.motion, AdjustedMotion)
    for node in motion.motion.times[1:-1].tolist():
        for read in (motion.angular, motion.linear):
            assert read(node - 1000) == pytest.approx(read(node + 1000), abs=1e-3)


def test_the_relative_speed_of_every_settled_window_is_known(calm: Run):
    follow = RelativeSpeed().follow
    speeds = np.array([follow(estimate) for estimate in calm.estimates])[SETTLED:]
    assert np.isfinite(speeds).all() and speeds.max() < 3 * speeds.min()


def test_a_window_that_comes_again_changes_nothing(calm: Run):
    estimator = make_estimator(calm.recording.camera, CONFIG)
    once = [estimator.estimate(window) for window in calm.windows[:4]]
    again = estimator.estimate(calm.windows[3])
    assert again.angular == pytest.approx(once[3].angular, abs=0.02)
    after = estimator.estimate(calm.windows[4])
    assert calm.error(after) < 3.0


def test_a_rotation_has_no_direction_of_travel():
    turning = run_of("rotation")
    settled = turning.estimates[SETTLED:]
    assert all(e.model is MotionModel.ROTATION for e in settled)
    assert all(e.covariance[0, 0] == -1 for e in settled)
    error = [turning.error(e) for e in settled]
    assert np.median(error) < 1.5


def test_the_same_windows_give_the_same_bits(calm: Run):
    for a, b in zip(calm.estimates, estimates_of(calm.recording, calm.windows), strict=True):
        assert np.array_equal(a.angular, b.angular)
        assert np.array_equal(a.covariance, b.covariance)


def test_another_origin_of_the_clock_changes_nothing(calm: Run):
    shift = 23 * 1_000_000_000 + 17
    moved = replace(calm.recording.events, t=calm.recording.events.t + shift)
    for a, b in zip(calm.estimates, estimates_of(calm.recording, windows_of(moved)), strict=True):
        assert b.t == a.t + shift
        assert b.angular == pytest.approx(a.angular, abs=1e-9)


def test_after_a_gap_the_memory_begins_anew(calm: Run):
    events = calm.recording.events
    t0 = int(events.t[0])
    late = replace(events, t=events.t + 2_000_000_000)
    both = Events.concatenate([events[events.t < t0 + 400 * NS_PER_MS], late])
    estimates = estimates_of(calm.recording, windows_of(both))
    after = [e for e in estimates if e.t > t0 + 2_000_000_000 + 400 * NS_PER_MS]
    errors = [calm.error(replace(e, t=e.t - 2_000_000_000)) for e in after if e.status is Status.OK]
    assert len(errors) >= 4
    assert np.median(errors) < 2.0


def test_a_motion_that_begins_at_once_is_followed():
    """All patches that are remembered moved slowly: none is found where it is expected."""
    recording = simulate("rotation", duration_s=0.6, seed=4, fps=500)
    events, t0 = recording.events, int(recording.events.t[0])
    begin, slower, faster = 120 * NS_PER_MS, 6, 2  # the first 0.12 s last 0.72 s, then it hurries
    since = events.t - t0
    late = begin * slower + (since - begin) // faster
    t = t0 + np.where(since < begin, since * slower, late)
    fast = 0
    for e in estimates_of(recording, windows_of(replace(events, t=t))):
        after = e.t - t0 - begin * slower
        if after > 0:
            true = faster * recording.truth.twist(t0 + begin + after * faster)[1]
            assert np.degrees(np.linalg.norm(true)) > 100
            assert np.degrees(np.linalg.norm(e.angular - true)) < 20
            fast += 1
    assert fast >= 3


def test_a_window_s_wrong_motion_does_not_refute_places_that_fit(calm: Run):
    camera = calm.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    reader = RememberingEstimator(lattice, camera, lambda estimate, depths: (estimate, None))
    memory = reader.nothing()
    for window in calm.windows[:-1]:
        memory, _ = reader.step(memory, window, lattice.estimate(window))
    found = lattice.estimate(calm.windows[-1])
    wrong = replace(
        found, angular=found.angular + np.radians([60, 0, 0]), covariance=1e-6 * np.eye(6)
    )
    _, told = reader.step(memory, calm.windows[-1], wrong)
    assert calm.error(wrong) > 50
    assert calm.error(told) < 3


def test_a_direction_is_told_only_where_it_is_sure_enough(calm: Run):
    """Its variance is the same all around it, but for other ways and parts of the patches."""
    camera, told = calm.recording.camera, []
    for widest in (60.0, 1.0):
        lattice = LatticeEstimator(camera, LatticeConfig())
        back = BackEndSettings(widest_direction_deg=widest)
        reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None), back=back)
        memory = reader.nothing()
        for window in calm.windows[:6]:
            memory, estimate = reader.step(memory, window, lattice.estimate(window))
        told.append(estimate)
    sure, unsure = told
    state = memory.odometry
    own = sure.covariance[:3, :3] - state.spread(sure.t)[1]
    across = np.eye(3) - np.outer(sure.linear, sure.linear)
    variance = np.trace(own) / 2
    assert own == pytest.approx(variance * across)
    assert np.radians(1) < np.sqrt(variance) < np.radians(60)
    assert unsure.model is MotionModel.ROTATION
    assert unsure.covariance[0, 0] == -1
    assert not unsure.linear.any()
    assert unsure.angular.tolist() == sure.angular.tolist()


def test_patches_learn_what_a_turned_flow_shows_after_the_adjustment(calm: Run):
    camera, learnt = calm.recording.camera, []
    for turned in (0.1, 2.0):  # sine: sometimes, never
        lattice = LatticeEstimator(camera, LatticeConfig())
        front = FrontEndSettings(turned=turned)
        reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None), front)
        memory = reader.nothing()
        for window in calm.windows[:6]:
            memory, _ = reader.step(memory, window, lattice.estimate(window))
        patches = memory.odometry.patches
        u, v = patches.toward.astype(np.float32).T[..., None, None]
        along_x, along_y = patches.full.transpose(1, 0, 2, 3)
        first, across = u * along_x + v * along_y, u * along_y - v * along_x
        # Slopes that were never corrected are zero where the first flow showed no event.
        learnt.append(np.abs(across[first == 0]).max(initial=0.0))
    assert learnt[0] > 0.01
    assert learnt[1] < 1e-6
