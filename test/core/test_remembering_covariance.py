"""How sure a remembered motion is told to be, by its patches and by its window."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from test_remembering import Run, run_of

from emoflow_ros.core.back_end.adjustment_kernels import Unknowns, rotated
from emoflow_ros.core.back_end.consistency import Experience, variance_by_gyro
from emoflow_ros.core.back_end.hypotheses import Hypotheses
from emoflow_ros.core.back_end.jackknife import ByParts
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import interpolated
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.odometry import State
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.types.estimate import Estimate, MotionModel
from emoflow_ros.core.types.gyro import GyroState, GyroStatus

C, S = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
TILT = np.array([[C, -S, 0.0], [S, C, 0.0], [0.0, 0.0, 1.0]])
W_ONLY, V_ONLY = np.diag([1.0, 2.0, 3.0]), np.diag([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Turning:
    """A constant rotation (a Motion)."""

    w: np.ndarray

    def angular(self, _: int) -> np.ndarray:
        return self.w

    def linear(self, _: int) -> np.ndarray:
        return np.zeros(3)


@pytest.fixture(scope="module")
def calm() -> Run:
    return run_of("calm")


def last_of(run: Run, *, warm: bool = True) -> Estimate:
    """Estimate the sixth window by its last part, whose flow is said to be warm or cold."""
    camera = run.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None))
    memory = reader.nothing()
    for window in run.windows[:6]:
        found = lattice.estimate(window)
        found = replace(found, t_start=(found.t + 2 * found.t_start) // 3)
        found = replace(found, quality=replace(found.quality, warm=warm))
        memory, estimate = reader.step(memory, window, found)
    return estimate


def spread_of(monkeypatch: pytest.MonkeyPatch, variance: float) -> None:
    """Let ways and parts of the image differ by variances of w, twice as much of the direction."""
    monkeypatch.setattr(State, "spread", lambda *_: (variance * W_ONLY, 2 * variance * V_ONLY))


def at_one_with_the_lattice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the lattice's w be the adjusted one, where what is told of the error is concerned."""
    learnt = Experience.after
    monkeypatch.setattr(Experience, "after", lambda *args: replace(learnt(*args), away=np.zeros(3)))


def test_a_motion_is_less_sure_where_few_patches_are_found_again(
    calm: Run, monkeypatch: pytest.MonkeyPatch
):
    spread_of(monkeypatch, 0.0)
    at_one_with_the_lattice(monkeypatch)
    told = []
    for kept in (0.5, 0.25):
        monkeypatch.setattr(Patches, "kept", lambda *_, kept=kept: kept)
        told.append(last_of(calm))
    many, few = told
    assert few.covariance[3:, 3:] == pytest.approx(4 * many.covariance[3:, 3:])
    assert few.covariance[:3, :3] == pytest.approx(2 * many.covariance[:3, :3])
    assert few.angular.tolist() == many.angular.tolist()


def test_only_of_a_warm_fit_the_length_counts(calm: Run, monkeypatch: pytest.MonkeyPatch):
    spread_of(monkeypatch, 0.0)
    at_one_with_the_lattice(monkeypatch)
    warm, cold = last_of(calm), last_of(calm, warm=False)
    part = (warm.t_end - warm.t_start) / 1e9
    assert part < 0.9 * calm.windows[5].duration
    longer = calm.windows[5].duration / part
    assert cold.covariance[3:, 3:] == pytest.approx(longer * warm.covariance[3:, 3:])
    assert cold.covariance[:3, :3] == pytest.approx(warm.covariance[:3, :3])


def test_half_the_squared_distance_to_the_lattice_s_w_in_the_window_is_added(
    calm: Run, monkeypatch: pytest.MonkeyPatch
):
    camera = calm.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    founds = [lattice.estimate(window) for window in calm.windows[:6]]
    off = np.radians([3.0, -1.0, 2.0])
    founds[-1] = replace(founds[-1], angular=founds[-1].angular + off)

    def last() -> Estimate:
        reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None))
        memory = reader.nothing()
        for window, found in zip(calm.windows, founds, strict=False):
            memory, estimate = reader.step(memory, window, found)
        return estimate

    whole = last()
    at_one_with_the_lattice(monkeypatch)
    without = last()
    away = founds[-1].angular - whole.angular
    assert np.degrees(np.linalg.norm(away)) > 1
    added = whole.covariance[3:, 3:] - without.covariance[3:, 3:]
    assert added == pytest.approx(0.5 * np.outer(away, away))


def test_what_rests_on_a_part_of_the_image_is_spread_as_other_ways_are(
    calm: Run, monkeypatch: pytest.MonkeyPatch
):
    camera = calm.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None))
    memory = reader.nothing()
    for window in calm.windows[:4]:
        memory, _ = reader.step(memory, window, lattice.estimate(window))
    state = memory.odometry
    assert state.parts is not None
    assert state.parts.farther is not None
    assert (np.abs(state.parts.changes).max(axis=(0, 2)) > 0).all()  # each quarter tells something
    of_ways = np.diag([0.3, 0.2, 0.1])
    monkeypatch.setattr(Hypotheses, "spread", lambda *_: (of_ways, V_ONLY))
    growing = np.linspace(0, 1, len(state.t))  # from node to node
    assert state.hypotheses is not None
    turned = rotated(np.eye(3), np.array([0.0, 0.0, 0.2]))
    mean = state.hypotheses.mean
    farther = mean._replace(velocity=mean.velocity @ turned.T)
    state = replace(state, parts=ByParts(growing[:, None, None] * np.eye(4, 3), farther))
    linear, apart = (interpolated(state.t, x, int(state.t[-1]))[1] for x in (mean, farther))
    angle = np.arccos(linear @ apart / np.linalg.norm(linear) / np.linalg.norm(apart))
    of_w, of_v = state.spread(int(state.t[-1]))
    assert of_w == pytest.approx(of_ways + 0.75 * np.eye(3))
    assert np.trace(of_v - V_ONLY) == pytest.approx(0.5 * angle**2)
    assert (of_v - V_ONLY) @ linear == pytest.approx(np.zeros(3), abs=1e-9)
    halfway = int(state.t[-1] + state.t[-2]) // 2
    share = (growing[-1] + growing[-2]) / 2
    assert state.spread(halfway)[0] == pytest.approx(of_ways + 0.75 * share**2 * np.eye(3))


def test_the_spread_of_other_ways_is_added(calm: Run, monkeypatch: pytest.MonkeyPatch):
    spread_of(monkeypatch, 0.0)
    one_way = last_of(calm)
    spread_of(monkeypatch, 0.01)
    several = last_of(calm)
    assert several.covariance[3:, 3:] == pytest.approx(one_way.covariance[3:, 3:] + 0.01 * W_ONLY)
    of_direction = one_way.covariance[:3, :3] + 0.02 * V_ONLY
    assert several.covariance[:3, :3] == pytest.approx(of_direction)
    assert several.angular.tolist() == one_way.angular.tolist()


def test_a_direction_that_is_wide_on_one_axis_is_not_told(
    calm: Run, monkeypatch: pytest.MonkeyPatch
):
    spread_of(monkeypatch, 0.5)  # 57 degrees
    assert last_of(calm).translation_observable
    spread_of(monkeypatch, 0.6)  # 63 degrees
    wide = last_of(calm)
    assert not wide.translation_observable
    assert wide.linear.tolist() == [0, 0, 0]


def test_ways_and_times_of_the_nodes_stay_in_step(calm: Run):
    camera = calm.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None))
    memory, taken, ways = reader.nothing(), 0, 0
    for window in calm.windows:
        before = memory.odometry.t
        memory, _ = reader.step(memory, window, lattice.estimate(window))
        state = memory.odometry
        taken += len(np.setdiff1d(state.t, before))
        assert (state.hypotheses is None) == (state.adjusted is None)
        for way in state.hypotheses.ways if state.hypotheses else ():
            assert [len(values) for values in way[:4]] == [len(state.t)] * 4
            assert way.position[-1].tolist() == [0, 0, 0]
        ways = max(ways, len(state.hypotheses.ways) if state.hypotheses else 0)
    assert taken > len(memory.odometry.t)  # some were forgotten
    assert ways > 1


def test_with_a_gyro_the_error_of_its_w_widens_the_direction(calm: Run):
    law, told = BackEndSettings().errors, []
    camera = calm.recording.camera
    for of_gyro in (0.0, law.of_gyro):
        lattice = LatticeEstimator(camera, LatticeConfig())
        back = BackEndSettings(errors=replace(law, of_gyro=of_gyro))
        reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None), back=back)
        memory = reader.nothing()
        for window in calm.windows[:6]:
            found = replace(lattice.estimate(window), gyro=GyroStatus(GyroState.USED))
            memory, estimate = reader.step(memory, window, found)
        told.append(estimate)
    motion = memory.odometry.motion(found.t)
    assert motion is not None
    speed = float(np.linalg.norm(motion.linear))
    variance = variance_by_gyro(found.covariance[3:, 3:], speed, law)
    without, using = told
    across = np.eye(3) - np.outer(using.linear, using.linear)
    assert using.linear.any() and variance > 1e-6
    assert using.covariance[:3, :3] - without.covariance[:3, :3] == pytest.approx(variance * across)


@pytest.mark.parametrize("gyro", [GyroState.NONE, GyroState.USED])
def test_before_a_motion_is_adjusted_a_window_is_less_sure_than_the_lattice(
    calm: Run, gyro: GyroState
):
    camera = calm.recording.camera
    lattice = LatticeEstimator(camera, LatticeConfig())
    front = FrontEndSettings(first_slices=2)
    reader = RememberingEstimator(lattice, camera, lambda e, depths: (e, None), front)
    found = replace(lattice.estimate(calm.windows[0]), gyro=GyroStatus(gyro))
    covariance = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    known = replace(found, model=MotionModel.FULL, linear=np.eye(3)[0], covariance=covariance)
    unknown = replace(found, model=MotionModel.ROTATION, covariance=without_translation(covariance))
    _, told = reader.step(reader.nothing(), calm.windows[0], known)
    of_w = 1.0 if gyro is GyroState.USED else 3.0
    assert told.covariance == pytest.approx(np.repeat([3.0, of_w], 3) * covariance)
    _, told = reader.step(reader.nothing(), calm.windows[0], unknown)
    assert told.covariance[:3, :3].tolist() == without_translation(covariance)[:3, :3].tolist()
    assert told.covariance[3:, 3:] == pytest.approx(of_w * covariance[3:, 3:])


def test_the_flow_goes_by_the_likeliest_way_whose_direction_is_not_told(calm: Run):
    flows = []
    for widest in (BackEndSettings().widest_direction_deg, 1e-6):
        camera = calm.recording.camera
        lattice = LatticeEstimator(camera, LatticeConfig())
        back = BackEndSettings(widest_direction_deg=widest)
        reader = RememberingEstimator(lattice, camera, lattice.refined, back=back)
        told = [reader.estimate(window) for window in calm.windows[:6]][-1]
        assert told.translation_observable is (widest > 1)
        assert told.flow is not None
        flows.append(told.flow.velocity(told.t))
    assert flows[1] == pytest.approx(flows[0], abs=0.1)


@pytest.mark.parametrize("gyro", [GyroState.NONE, GyroState.USED])
def test_the_flow_goes_by_the_way_that_the_depths_belong_to(
    calm: Run, gyro: GyroState, monkeypatch: pytest.MonkeyPatch
):
    camera, off = calm.recording.camera, np.radians([2.0, 0.0, 0.0])
    lattice, seen = LatticeEstimator(camera, LatticeConfig()), []

    def refine(likeliest: Estimate, _: object) -> tuple[Estimate, None]:
        seen.append(likeliest)
        return likeliest, None

    def with_a_rival(self: Hypotheses) -> Unknowns:
        """Tell another mean: that of a rival which turns and goes otherwise."""
        way = self.ways[0]
        return way._replace(angular=way.angular + off, velocity=way.velocity @ TILT)

    monkeypatch.setattr(Hypotheses, "mean", property(with_a_rival))
    reader = RememberingEstimator(lattice, camera, refine)
    memory = reader.nothing()
    for window in calm.windows[:6]:
        found = replace(lattice.estimate(window), gyro=GyroStatus(gyro))
        turning = calm.true_angular(found.t) + off
        if gyro is GyroState.USED:
            found = replace(found, angular=turning, motion=Turning(turning))
        memory, told = reader.step(memory, window, found)
    hypotheses, used = memory.odometry.hypotheses, seen[-1]
    assert hypotheses is not None and used.motion is not None
    w, v, _ = interpolated(memory.odometry.t, hypotheses.ways[0], told.t)
    direction = v / np.linalg.norm(v)
    assert used.motion.angular(told.t) == pytest.approx(w)
    assert used.linear == pytest.approx(direction)
    assert used.model is MotionModel.FULL
    assert told.linear @ direction < np.cos(np.radians(5.0))
    assert np.degrees(np.linalg.norm(told.angular - w)) > 0.3
