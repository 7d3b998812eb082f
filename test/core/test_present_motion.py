"""The motion of now on simulated recordings, whose motion is known at every instant."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from emoflow_ros.core.config import load_config
from emoflow_ros.core.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, SLICE_MS, Window, WindowSlicer
from emoflow_ros.core.factory import make_estimator
from emoflow_ros.core.gyro_checks import GyroState, GyroStatus
from emoflow_ros.core.gyro_measurement import GyroMeasurement, GyroReadings, fit_shape
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.present_motion import PresentMotion
from emoflow_ros.core.reading import with_gyro as gyro_tells
from emoflow_ros.core.thinning import spread
from emoflow_ros.simulation.recording import SimulatedRecording
from emoflow_ros.simulation.simulate import simulate

SLICE_NS = round(SLICE_MS * NS_PER_MS)
LATE_NS = 60 * NS_PER_MS  # from a window's end until its estimate is there
CONFIG = load_config(overrides={"estimator.max_doubt": 1.0})  # withholds no window
STEP_NS = 20 * NS_PER_MS


@dataclass
class Run:
    """Estimates of a recording's windows."""

    recording: SimulatedRecording
    estimates: list[Estimate]

    def slice(self, t_end: int) -> Window:
        events = self.recording.events
        first, last = np.searchsorted(events.t, [t_end - SLICE_NS, t_end])
        return Window(t_end - SLICE_NS, t_end, events[first:last])

    def present(self) -> PresentMotion:
        return PresentMotion(self.recording.camera, CONFIG.estimator)

    def angular(self, t: int) -> np.ndarray:
        return self.recording.truth.twist(t)[1]


@cache
def run(scene: str) -> Run:
    recording = simulate(scene, duration_s=1.2, seed=0)
    estimator = make_estimator(recording.camera, CONFIG)
    windows = WindowSlicer(CONFIG.window).push(recording.events)
    return Run(recording, [estimator.estimate(window) for window in windows])


def last(scene: str) -> tuple[Run, Estimate]:
    its = run(scene)
    return its, [e for e in its.estimates if e.translation_observable][-2]


@dataclass(frozen=True)
class Exactly:
    """A window's motion with the true angular velocity (a Motion)."""

    its: Run
    estimate: Estimate

    def angular(self, t: int) -> np.ndarray:
        return self.its.angular(t)

    def linear(self, t: int) -> np.ndarray:
        assert self.estimate.motion is not None
        return self.estimate.motion.linear(t)


def degrees(error: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(error)))


def test_it_follows_a_motion_that_changes_where_the_last_window_does_not() -> None:
    its, present = run("agile"), run("agile").present()
    errors, held, squares = [], [], []
    for estimate in its.estimates[4:]:
        present.know(estimate)
        for k in range(3):
            t = estimate.t_end + LATE_NS + k * STEP_NS
            found = present.estimate(its.slice(t))
            if found is None:
                continue
            error = found.twist.angular - its.angular(t)
            errors.append(degrees(error))
            held.append(degrees(estimate.angular - its.angular(t)))
            squares.append(error @ np.linalg.solve(found.covariance[3:, 3:], error) / 3)
    assert len(errors) > 30
    assert np.sqrt(np.mean(np.square(errors))) < 0.5 * np.sqrt(np.mean(np.square(held)))
    assert 0.3 < np.mean(squares) < 3


def test_variance_grows_with_the_change_that_the_window_did_not_tell() -> None:
    """A fifth of its square, a third of it along each axis, and the drift by it."""
    its, estimate = last("agile")
    present = its.present()
    present.know(estimate)
    t = estimate.t_end + LATE_NS
    found = present.estimate(its.slice(t))
    assert found is not None and estimate.motion is not None
    angular, end = estimate.motion.angular, estimate.t_end - 5 * NS_PER_MS
    slope = (angular(estimate.t_end) - angular(estimate.t_start)) / (
        (estimate.t_end - estimate.t_start) / NS_PER_S
    )
    told = angular(end) + slope * 0.06 * (1 - np.exp(-(t - end) / (0.06 * NS_PER_S)))
    change = found.twist.angular - told
    seconds = (t - SLICE_NS // 2 - end) / NS_PER_S
    expected = 0.2 * change @ change / 3 + 0.5 * change @ change / (3 * seconds) * 0.03
    assert np.diag(found.covariance)[3:].min() > expected
    assert expected > np.radians(1) ** 2


def test_the_same_slice_and_window_give_the_same_bits() -> None:
    its, estimate = last("agile")
    found = []
    for before in (its.estimates[0], its.estimates[5]):
        present = its.present()
        present.know(before)
        present.estimate(its.slice(before.t_end + LATE_NS))
        present.know(estimate)
        found.append(present.estimate(its.slice(estimate.t_end + LATE_NS)))
    assert found[0] is not None and found[1] is not None
    np.testing.assert_array_equal(found[0].twist.angular, found[1].twist.angular)
    np.testing.assert_array_equal(found[0].covariance, found[1].covariance)


def test_direction_has_unit_length_and_no_variance_along_itself() -> None:
    its, estimate = last("calm")
    present = its.present()
    present.know(estimate)
    found = present.estimate(its.slice(estimate.t_end + LATE_NS))
    assert found is not None
    v = found.twist.linear
    assert np.linalg.norm(v) == pytest.approx(1.0)
    assert v @ estimate.linear > np.cos(np.radians(30))
    assert abs(v @ found.covariance[:3, :3] @ v) < 1e-9
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-9


def test_without_a_direction_of_travel_only_the_rotation_is_told() -> None:
    its, estimate = last("calm")
    covariance = np.zeros((6, 6))
    covariance[0, 0], covariance[3:, 3:] = -1.0, estimate.covariance[3:, 3:]
    turning = replace(
        estimate, model=MotionModel.ROTATION, linear=np.zeros(3), covariance=covariance
    )
    present = its.present()
    present.know(turning)
    found = present.estimate(its.slice(estimate.t_end + LATE_NS))
    assert found is not None
    np.testing.assert_array_equal(found.twist.linear, np.zeros(3))
    assert found.covariance[0, 0] == -1.0
    np.testing.assert_array_equal(found.covariance[:3, 3:], np.zeros((3, 3)))


def with_gyro(window: Window, its: Run, bias: np.ndarray) -> Window:
    t = np.arange(window.t_start - 50 * NS_PER_MS, window.t_end + 50 * NS_PER_MS, NS_PER_MS)
    return replace(window, gyro=GyroReadings(t, np.array([its.angular(k) + bias for k in t])))


def test_a_gyro_tells_the_change_since_the_window_whatever_its_bias() -> None:
    its = run("agile")
    bias = np.radians([3.0, -2.0, 1.0])
    errors, held = [], []
    for estimate in its.estimates[4:]:
        if not estimate.translation_observable:
            continue
        used = GyroStatus(GyroState.USED)
        true = replace(
            estimate, angular=its.angular(estimate.t), motion=Exactly(its, estimate), gyro=used
        )
        present = its.present()
        window = Window(estimate.t_start, estimate.t_end, its.recording.events[:0])
        present.know(true, with_gyro(window, its, bias).gyro)
        t = estimate.t_end + LATE_NS
        found = present.estimate(with_gyro(its.slice(t), its, bias))
        alone = present.estimate(its.slice(t))
        if found is None or alone is None:  # the recording has ended
            continue
        errors.append(degrees(found.twist.angular - its.angular(t)))
        held.append(degrees(true.angular - its.angular(t)))
        assert np.trace(found.covariance[3:, 3:]) < 0.5 * np.trace(alone.covariance[3:, 3:])
    assert len(errors) > 8
    assert np.sqrt(np.mean(np.square(errors))) < 2.0 < np.sqrt(np.mean(np.square(held)))


def test_after_a_doubtful_flow_the_gyro_alone_carries_the_motion_on() -> None:
    its, estimate = last("agile")
    assert estimate.translation_observable
    motion = Exactly(its, estimate)
    no_flow = replace(estimate, motion=motion, flow=None, gyro=GyroStatus(GyroState.USED))
    bias = np.radians([3.0, -2.0, 1.0])
    present = its.present()
    present.know(no_flow, with_gyro(its.slice(estimate.t_end), its, bias).gyro)
    t = estimate.t_end + LATE_NS
    found = present.estimate(with_gyro(its.slice(t), its, bias))
    assert found is not None
    assert degrees(found.twist.angular - its.angular(t)) < 0.5
    assert degrees(its.angular(estimate.t) - its.angular(t)) > 5
    before_end = estimate.t_end - 5 * NS_PER_MS
    np.testing.assert_allclose(found.twist.linear, motion.linear(before_end), atol=1e-9)
    of_v = np.trace(found.covariance[:3, :3])
    assert of_v > np.trace(estimate.covariance[:3, :3])
    assert present.estimate(its.slice(t)) is None
    late = with_gyro(its.slice(t), its, bias)
    assert late.gyro is not None
    before = late.gyro.t < t - 25 * NS_PER_MS
    stale = GyroReadings(late.gyro.t[before], late.gyro.w[before])
    assert present.estimate(replace(late, gyro=stale)) is None
    frozen = GyroReadings(late.gyro.t, np.ones_like(late.gyro.w))
    assert present.estimate(replace(late, gyro=frozen)) is None


def test_after_a_window_by_the_gyro_alone_the_gyro_tells_w_and_nothing_tells_v() -> None:
    its, estimate = last("agile")
    bias = np.radians([3.0, -2.0, 1.0])
    used = GyroStatus(GyroState.USED)
    nothing = replace(estimate, status=Status.NO_MOTION, flow=None, gyro=used)
    window = with_gyro(
        Window(estimate.t_start, estimate.t_end, its.recording.events[:0]), its, bias
    )
    assert window.gyro is not None
    shape = fit_shape(window.gyro, window.t_start, window.t_end).coefficients
    shape[0] -= bias
    covariances = np.tile(1e-6 * np.eye(3), (3, 1, 1))
    measured = GyroMeasurement(window.t_start, window.t_end, shape, covariances)
    present = its.present()
    present.know(gyro_tells(nothing, measured, LatticeConfig()), window.gyro)
    t = estimate.t_end + LATE_NS
    found = present.estimate(with_gyro(its.slice(t), its, bias))
    assert found is not None
    assert degrees(found.twist.angular - its.angular(t)) < 0.5
    assert degrees(its.angular(estimate.t) - its.angular(t)) > 5
    np.testing.assert_array_equal(found.twist.linear, 0)
    assert found.covariance[0, 0] == -1


def test_with_a_gyro_a_doubtful_window_still_tells_w() -> None:
    its = run("calm")
    options = {"imu.use": "auto", "imu.bias_deg_s": 2.0, "estimator.max_doubt": 1e-6}
    config = load_config(overrides=options)
    estimator = make_estimator(its.recording.camera, config)
    windows = WindowSlicer(config.window).push(its.recording.events)
    for k, window in enumerate(windows[:3]):
        found = estimator.estimate(with_gyro(window, its, np.zeros(3)))
        assert (found.status, found.flow) == (Status.OK, None)
        assert not found.translation_observable
        assert degrees(found.angular - its.angular(found.t)) < (0.2 if k == 0 else 1.5)
        if k == 0:  # all that is known of the bias is how large it may be
            sigma = np.degrees(np.sqrt(np.diag(found.covariance)[3:]))
            np.testing.assert_allclose(sigma, 2.0, atol=0.1)


@pytest.mark.parametrize("status", [s for s in Status if s is not Status.OK])
def test_after_a_window_without_an_estimate_there_is_no_motion_of_now(status: Status) -> None:
    its, estimate = last("calm")
    present = its.present()
    present.know(estimate)
    present.know(replace(estimate, status=status))
    assert present.estimate(its.slice(estimate.t_end + LATE_NS)) is None


def test_an_old_window_and_one_from_later_tell_nothing_of_now() -> None:
    its = run("agile")
    estimate = next(e for e in its.estimates if e.translation_observable)
    present = its.present()
    present.know(estimate)
    after_ms = [present.estimate(its.slice(estimate.t + ms * NS_PER_MS)) for ms in (0, 599, 601)]
    assert [found is not None for found in after_ms] == [False, True, False]


def test_few_events_tell_nothing_of_now() -> None:
    its, estimate = last("calm")
    present = its.present()
    present.know(estimate)
    window = its.slice(estimate.t_end + LATE_NS)
    assert present.estimate(replace(window, events=spread(window.events, 3_000))) is not None
    assert present.estimate(replace(window, events=spread(window.events, 250))) is None


def after_a_window_with_a_gyro(scene: str) -> tuple[PresentMotion, Window, GyroReadings]:
    """The motion of now that knows a window, a slice after it, and that slice's readings."""
    its, estimate = last(scene)
    used = replace(estimate, gyro=GyroStatus(GyroState.USED))
    present = its.present()
    present.know(used, with_gyro(its.slice(estimate.t_end), its, np.zeros(3)).gyro)
    later = with_gyro(its.slice(estimate.t_end + LATE_NS), its, np.zeros(3))
    assert later.gyro is not None
    return present, later, later.gyro


def test_a_gyro_that_ends_within_the_slice_is_less_sure_at_its_end() -> None:
    present, whole, gyro = after_a_window_with_a_gyro("calm")
    before = gyro.t < whole.t_end - 40 * NS_PER_MS
    short = replace(whole, gyro=GyroReadings(gyro.t[before], gyro.w[before]))
    sure, unsure = present.estimate(whole), present.estimate(short)
    assert sure is not None and unsure is not None
    # The drift that is expected of 60 deg/s per root second over the slice's second half, 30 ms
    grown = np.diag(unsure.covariance - sure.covariance)[3:]
    least = 0.5 * (0.15 * np.radians(60)) ** 2 * 0.03
    assert grown.min() > 0.99 * least


def test_a_frozen_gyro_does_not_hold_the_motion() -> None:
    present, alive, gyro = after_a_window_with_a_gyro("agile")
    frozen = replace(alive, gyro=GyroReadings(gyro.t, np.ones_like(gyro.w)))
    found, without = present.estimate(frozen), present.estimate(replace(alive, gyro=None))
    assert found is not None and without is not None
    np.testing.assert_array_equal(found.twist.angular, without.twist.angular)
