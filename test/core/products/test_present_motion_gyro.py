"""The latest twist where a gyro carries it on."""

from dataclasses import dataclass, replace

import numpy as np
from present_runs import LATE_NS, Run, degrees, last, run

from emoflow_ros.core.gyro.measurement import GyroMeasurement, fit_shape
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.reading import with_gyro as gyro_tells
from emoflow_ros.core.products.present_motion import PresentMotion
from emoflow_ros.core.products.settings import PRESENT
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.core.types.gyro import GyroReadings, GyroState, GyroStatus


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


def test_after_a_window_without_a_flow_the_gyro_alone_carries_the_motion_on() -> None:
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
    walk = present.estimate(its.slice(t))
    late = with_gyro(its.slice(t), its, bias)
    assert late.gyro is not None
    before = late.gyro.t < t - 25 * NS_PER_MS
    stale = GyroReadings(late.gyro.t[before], late.gyro.w[before])
    frozen = GyroReadings(late.gyro.t, np.ones_like(late.gyro.w))
    assert walk is not None
    for useless in (stale, frozen):
        alone = present.estimate(replace(late, gyro=useless))
        assert alone is not None
        np.testing.assert_array_equal(alone.twist.angular, walk.twist.angular)
    assert np.trace(walk.covariance[3:, 3:]) > 10 * np.trace(found.covariance[3:, 3:])


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


def after_a_window_with_a_gyro(scene: str) -> tuple[PresentMotion, Window, GyroReadings]:
    """The latest twist that knows a window, a slice after it, and that slice's readings."""
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


def carried_by_gyro(its: Run, estimate: Estimate, known_until: int) -> np.ndarray:
    """Covariance of the latest twist by a gyro alone, whose readings the window knows so far."""
    no_flow = replace(estimate, flow=None, gyro=GyroStatus(GyroState.USED))
    gyro = with_gyro(its.slice(estimate.t_end), its, np.zeros(3)).gyro
    assert gyro is not None
    early = gyro.t <= known_until
    present = its.present()
    present.know(no_flow, GyroReadings(gyro.t[early], gyro.w[early]))
    found = present.estimate(with_gyro(its.slice(estimate.t_end + LATE_NS), its, np.zeros(3)))
    assert found is not None
    return found.covariance


def test_a_gyro_that_ends_before_the_window_tells_less_of_the_change_after_it() -> None:
    """Where it turns by 20 rad/s^2 from its last reading on."""
    its, estimate = last("agile")
    whole = carried_by_gyro(its, estimate, estimate.t_end)
    held = carried_by_gyro(its, estimate, estimate.t_end - 20 * NS_PER_MS)
    more = np.diag(held - whole)[3:]
    assert (more > (20.0 * 0.015) ** 2).all() and (more < (20.0 * 0.045) ** 2).all()


def test_readings_that_end_before_now_tell_less_of_it() -> None:
    """10 ms before the slice's end: 20 rad/s^2 for 15 ms of the 10 ms around it."""
    its, estimate = last("agile")
    present, gyro = its.present(), with_gyro(its.slice(estimate.t_end), its, np.zeros(3)).gyro
    present.know(replace(estimate, flow=None, gyro=GyroStatus(GyroState.USED)), gyro)
    t = estimate.t_end + LATE_NS
    live = with_gyro(its.slice(t), its, np.zeros(3))
    assert live.gyro is not None
    sigma = []
    for lag_ms in (0, 5, 10):
        read = live.gyro.t <= t - lag_ms * NS_PER_MS
        part = GyroReadings(live.gyro.t[read], live.gyro.w[read])
        found = present.estimate(replace(live, gyro=part))
        assert found is not None
        sigma.append(np.sqrt(np.diag(found.covariance)[3:].mean()))
    # The mean's error by the readings that lack, beside those of a gyro that is read until now
    more = [np.sqrt(late**2 - sigma[0] ** 2) for late in sigma[1:]]
    gaps = np.array([20 * ms**2 / 2 / 10 for ms in (5, 10, 15)]) * 1e-3
    np.testing.assert_allclose(more, np.sqrt(gaps[1:] ** 2 - gaps[0] ** 2), rtol=0.02)


def test_a_camera_that_shakes_goes_on_shaking_after_the_last_reading() -> None:
    """The gyro reaches the slice's middle, not its end, where the window may foresee another w.

    The surprise is put in: by how much the window itself is wrong hangs on rounding.
    """
    present, whole, gyro = after_a_window_with_a_gyro("agile")
    before = gyro.t < whole.t_end - 40 * NS_PER_MS
    short = replace(whole, gyro=GyroReadings(gyro.t[before], gyro.w[before]))
    scene = present._scene
    assert scene is not None
    half = min(whole.t_end - whole.t_start, scene.length_ns) // 2
    middle = whole.t_end - half
    told = scene.change_by_gyro(short.gyro, middle)
    assert told is not None
    seconds = scene.predicted_change(middle)[0] / scene.angular_acceleration[0]
    foreseeing = replace(scene, angular_acceleration=told[0] / seconds)
    surprised = replace(scene, angular_acceleration=told[0] / seconds - 2.0)  # rad/s^2
    present._scene = surprised
    shaking = present.estimate(short)
    present._scene = foreseeing
    foreseen = present.estimate(short)
    assert shaking is not None and foreseen is not None
    squares = []
    for found, known in ((shaking, surprised), (foreseen, foreseeing)):
        change = found.twist.angular - known.motion[:3] - known.predicted_change(whole.t_end)
        squares.append(change @ change)
    more = np.diag(shaking.covariance - foreseen.covariance)[3:]
    walked, rest = middle - scene.t, whole.t_end - middle
    assert walked > PRESENT.least_since_s * NS_PER_S
    np.testing.assert_allclose(more, (squares[0] - squares[1]) / 3 * rest / walked, rtol=1e-6)
    assert np.sqrt(more.min()) > np.radians(0.5)
