"""The estimator with a memory and a gyro: whose w counts, and what places teach of its bias."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from test_remembering import Run, run_of

from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.told_motion import ToldMotion, told_bias
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import Window
from emoflow_ros.core.types.gyro import GyroState, GyroStatus, KnownBias


@pytest.fixture(scope="module")
def calm() -> Run:
    return run_of("calm")


@dataclass(frozen=True)
class Told:
    """A rotation with what swings once over a window, most in the middle (a Motion)."""

    window: Window
    mean: np.ndarray
    swing: np.ndarray

    def angular(self, t: int) -> np.ndarray:
        s = (t - self.window.t_start) / (self.window.t_end - self.window.t_start)
        return self.mean - self.swing * np.cos(2 * np.pi * s)

    def linear(self, _: int) -> np.ndarray:
        return np.zeros(3)


def by_positions(
    run: Run, state: GyroState, off: np.ndarray, swing: np.ndarray
) -> tuple[np.ndarray, Estimate]:
    """Angular velocity by the memory, told that windows are off the truth, and sure."""
    camera = run.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None))
    memory = reader.nothing()
    for window in run.windows[:6]:
        found = lattice.estimate(window)
        motion = Told(window, run.true_angular(found.t) + off, swing)
        said = replace(
            found, angular=motion.angular(found.t), covariance=1e-8 * np.eye(6),
            motion=motion, gyro=GyroStatus(state),
        )  # fmt: skip
        memory, _ = reader.step(memory, window, said)
    found_motion = memory.odometry.motion(said.t)
    assert found_motion is not None
    return found_motion.angular, said


def test_a_gyro_draws_the_motion_by_positions_more_than_the_lattice_does(calm: Run):
    off, apart = np.radians([2.0, 0.0, 0.0]), []
    for state in (GyroState.NONE, GyroState.USED):
        angular, said = by_positions(calm, state, off, np.zeros(3))
        apart.append(float(np.degrees(np.linalg.norm(angular - said.angular))))
    assert apart[1] < 0.8 * apart[0]


def test_what_trembles_by_the_gyro_alone_is_held_by_the_places(calm: Run):
    """Part by part, so that the way over the window stays."""
    swing, nothing = np.radians([6.0, 0.0, 0.0]), np.zeros(3)
    steady, _ = by_positions(calm, GyroState.USED, nothing, nothing)
    trembling, said = by_positions(calm, GyroState.USED, nothing, swing)
    assert np.degrees(np.linalg.norm(said.angular - steady)) > 5
    assert 0.2 < np.degrees(np.linalg.norm(trembling - steady)) < 1.5


class WithGyro:
    """A lattice whose angular velocity a gyro with a bias tells (an Estimator)."""

    def __init__(self, run: Run, bias: np.ndarray, state: GyroState) -> None:
        self._lattice = LatticeEstimator(run.recording.camera, LatticeConfig())
        self._run, self._bias = run, bias
        known = KnownBias(np.zeros(3), np.radians(1.0) ** 2 * np.eye(3))
        used = state is GyroState.USED
        self._status = GyroStatus(state, bias=known if used else None)

    def reset(self) -> None:
        self._lattice.reset()

    def estimate(self, window: Window) -> Estimate:
        found = self._lattice.estimate(window)
        motion = Told(window, self._run.true_angular(found.t) + self._bias, np.zeros(3))
        covariance = np.radians(1.0) ** 2 * np.eye(6)
        return replace(
            found, angular=motion.angular(found.t), covariance=covariance, motion=motion,
            gyro=self._status,
        )  # fmt: skip


def test_places_teach_the_bias_of_a_gyro_that_is_used(calm: Run):
    bias, learnt = np.radians([2.0, -1.0, 0.5]), {}
    for state in (GyroState.USED, GyroState.REJECTED):
        learnt[state] = []
        reader = RememberingEstimator(
            WithGyro(calm, bias, state), calm.recording.camera, lambda e, depths: (e, None),
            learn_bias=learnt[state].append,
        )  # fmt: skip
        for window in calm.windows[:8]:
            reader.estimate(window)
    seen = learnt[GyroState.USED]
    assert len(seen) in (6, 7, 8)  # once a window, from the first adjustment on
    apart = np.degrees([np.linalg.norm(s.excess - bias) for s in seen])
    assert np.median(apart) < 0.6 * np.degrees(np.linalg.norm(bias))
    assert learnt[GyroState.REJECTED] == []


def test_a_bias_is_told_more_widely_than_places_say(calm: Run):
    back = BackEndSettings()
    reader = RememberingEstimator(
        WithGyro(calm, np.zeros(3), GyroState.USED), calm.recording.camera,
        lambda e, depths: (e, None),
    )  # fmt: skip
    memory = reader.nothing()
    for window in calm.windows[:6]:
        found = WithGyro(calm, np.zeros(3), GyroState.USED).estimate(window)
        memory, _ = reader.step(memory, window, found)
    state = memory.odometry
    told = told_bias(state, found.t, back)
    least = back.errors.bias * back.errors.least_cost
    more = told.covariance - least * state.bias.covariance - state.spread(found.t)[0]
    assert np.linalg.eigvalsh(more)[0] > -1e-12
    assert told.excess == pytest.approx(state.bias.excess)


def test_a_gyro_is_as_sure_as_places_find_its_bias_right(calm: Run):
    """Its w is told more widely, or less; the direction is not."""
    factors = []
    for bias in (0.0, 6.0):  # of a known standard deviation of 1
        gyro = WithGyro(calm, np.radians([bias, 0.0, 0.0]), GyroState.USED)
        reader = RememberingEstimator(gyro, calm.recording.camera, lambda e, depths: (e, None))
        memory = reader.nothing()
        for window in calm.windows[:8]:
            found = gyro.estimate(window)
            memory, estimate = reader.step(memory, window, found)
        kept = memory.odometry.patches.kept(FrontEndSettings().patience)
        told = ToldMotion.of(
            window, found, memory.odometry, memory.experience, kept, BackEndSettings()
        )
        factor = estimate.covariance[3, 3] / found.covariance[3, 3]
        assert estimate.covariance[3:, 3:] == pytest.approx(factor * found.covariance[3:, 3:])
        np.testing.assert_array_equal(estimate.covariance[:3, :3], told.covariance[:3, :3])
        factors.append(factor)
    assert factors[0] < 0.7
    assert factors[1] > 2
