"""A gyro in closed form: what it measures, how its bias is learnt, and its faults."""

from dataclasses import replace

import numpy as np
import pytest
from gyro_motion import (
    CONFIG,
    MS,
    PERFECT,
    START,
    WINDOW,
    S,
    follow,
    noisy,
    readings,
    turning,
    windows,
)

from emoflow_ros.config import load_config
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.core.types.gyro import GyroReadings, GyroState, SeenBias
from emoflow_ros.errors import InputError


@pytest.mark.parametrize("rate", [100, 500, 1000])
def test_constant_rotation(rate):
    w = np.array([0.1, -0.2, 0.3])
    got = Gyro(PERFECT).measure(START, START + WINDOW, readings(lambda x: w, rate=rate))
    np.testing.assert_allclose(got.w, w, atol=1e-11)
    np.testing.assert_allclose(got.coefficients[1:], 0, atol=1e-11)
    np.testing.assert_allclose(got.middle, w, atol=1e-11)
    np.testing.assert_allclose(got.at(0.3), w, atol=1e-11)


def test_rotation_that_grows_linearly_and_quadratically():
    linear, quadratic = np.array([2.0, -1.0, 0.5]), np.array([3.0, 20.0, -10.0])

    def w(x):
        return 0.1 + linear * x + quadratic * x**2

    got = Gyro(PERFECT).measure(START, START + WINDOW, readings(w))
    for s in (0.0, 0.25, 0.5, 1.0):
        np.testing.assert_allclose(got.at(s), w(s * 0.135), atol=2e-5)
    np.testing.assert_allclose(got.middle, w(0.0675), atol=2e-5)
    mean = 0.1 + linear * 0.135 / 2 + quadratic * 0.135**2 / 3
    np.testing.assert_allclose(got.w, mean, atol=2e-5)


def test_bounds_of_the_interval_are_between_readings():
    got = Gyro(PERFECT).measure(
        START + 3 * MS, START + 48 * MS, readings(lambda x: 5.0 * x, rate=100)
    )
    np.testing.assert_allclose(got.w, 5.0 * 0.0255, atol=1e-9)
    np.testing.assert_allclose(got.coefficients[1], 5.0 * 0.0225, atol=1e-9)


def test_covariance_is_that_of_the_noise():
    found = noisy(lambda x: 0.0, seconds=200.0, density=0.05)
    gyro = Gyro(replace(PERFECT, noise=0.05))
    got = [gyro.measure(t, t + WINDOW, found) for t in range(START, START + 199 * S, WINDOW)]
    for row in (0, 1):
        values = np.array([m.coefficients[row] for m in got])
        claimed = np.sqrt(np.diag(got[0].covariances[row]))
        np.testing.assert_allclose(values.std(axis=0), claimed, rtol=0.12)
    assert np.sqrt(got[0].covariance[0, 0]) == pytest.approx(np.radians(0.05) / 0.135**0.5, 0.01)


def test_covariance_has_bias_scale_and_mounting():
    config = GyroConfig(bias_deg_s=2.0, scale_error=0.02, rotation_error_deg=1.0)
    found = readings(lambda x: np.array([3.0, 0.0, 0.0]))
    covariance = Gyro(config).measure(START, START + WINDOW, found).covariance
    bias = np.radians(2.0)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.hypot(bias, 0.06), rel=0.01)
    assert np.sqrt(covariance[1, 1]) == pytest.approx(np.hypot(bias, 3 * np.radians(1.0)), rel=0.01)


def test_covariance_of_the_first_two_coefficients_has_the_clock():
    """An offset of the clock shifts w(t): mean and slope change by the slope and the bend."""

    def w(x: float) -> np.ndarray:
        return np.array([0.3, 4.0 * x, 100.0 * x**2])

    got = Gyro(PERFECT).measure(START, START + WINDOW, readings(w))
    offset = round(0.5 * MS)
    shifted = Gyro(PERFECT).measure(START + offset, START + WINDOW + offset, readings(w))
    still = Gyro(PERFECT).measure(START, START + WINDOW, readings(lambda x: 0.3))
    for row in (0, 1):
        apart = shifted.coefficients[row] - got.coefficients[row]
        by_change = np.diag(got.covariances[row] - still.covariances[row])
        np.testing.assert_allclose(np.sqrt(by_change), apart, rtol=0.02, atol=1e-6)
    assert got.covariances[1][2, 2] > 5e-3**2  # 100 rad/s^3 over 0.5 ms and half of the window


def test_readings_that_end_inside_cost_the_slope_more_than_the_mean():
    """Whatever happens after the last one counts three times as much for it."""
    found = readings(lambda x: 0.3)
    before = found.t < START + WINDOW - 20 * MS
    ended = GyroReadings(found.t[before], found.w[before])
    whole, held = (Gyro(PERFECT).measure(START, START + WINDOW, r) for r in (found, ended))
    more = held.covariances[:2, 0, 0] - whole.covariances[:2, 0, 0]
    mean = 20.0 * 0.021**2 / 2 / 0.135  # 20 rad/s^2 from the last reading on
    np.testing.assert_allclose(np.sqrt(more), [mean, 3 * mean], rtol=0.1)


def test_a_gap_adds_to_the_covariance():
    found = readings(lambda x: 0.3)
    keep = np.abs(found.t - (START + 60 * MS)) > 12 * MS
    whole = Gyro(CONFIG).measure(START, START + WINDOW, found)
    gap = Gyro(CONFIG).measure(START, START + WINDOW, GyroReadings(found.t[keep], found.w[keep]))
    np.testing.assert_allclose(gap.w, whole.w, atol=1e-11)
    assert gap.covariance[0, 0] > whole.covariance[0, 0] + np.radians(0.1) ** 2


@pytest.mark.parametrize("bias", [(1.0, -1.5, 0.5), (-2.0, 2.0, 3.0)])
def test_bias_is_found_within_ten_seconds(bias):
    b = np.radians(bias)
    gyro = Gyro(CONFIG)
    follow(gyro, noisy(lambda x: turning(x) + b, seconds=10.2), turning, 10.0)
    error = np.degrees(gyro.bias - b)
    assert np.sqrt(np.mean(error**2)) < 0.2
    claimed = np.degrees(np.sqrt(np.diag(gyro.bias_covariance)))
    assert (claimed > 0.05).all() and (claimed < 0.4).all()
    assert gyro.status.state is GyroState.USED


def test_measurement_is_free_of_the_bias_that_is_known():
    b = np.radians([1.0, -1.5, 0.5])
    measured = follow(Gyro(CONFIG), noisy(lambda x: turning(x) + b, seconds=10.2), turning, 10.0)
    t_start, t_end = windows(10.0)[-1]
    truth = turning(((t_start + t_end) / 2 - START) / S)
    assert np.degrees(np.abs(measured[-1].middle - truth)).max() < 0.25
    assert np.degrees(np.abs(measured[0].middle - turning(0.0675))).max() > 0.9


def test_repeated_estimates_do_not_count_as_independent_ones():
    """The same events' error over half a second teaches as much as two estimates."""
    gyro = Gyro(CONFIG)
    found = noisy(turning)
    for t_start, t_end in windows(0.7):
        gyro.measure(t_start, t_end, found)
        gyro.learn(turning(((t_start + t_end) / 2 - START) / S), np.radians(1.0) ** 2 * np.eye(3))
    claimed = np.degrees(np.sqrt(np.diag(gyro.bias_covariance)))
    assert (claimed > 0.45).all()  # thirteen independent ones of 1.1 deg/s would give 0.3


def test_a_bias_that_is_seen_is_learnt_by_its_covariance():
    gyro, b = Gyro(CONFIG), np.radians([0.9, -0.6, 0.3])
    gyro.measure(START, START + WINDOW, noisy(lambda x: turning(x) + b))
    before = gyro.bias_covariance
    sure = np.radians(0.1) ** 2 * np.eye(3)
    gyro.learn_bias(SeenBias(b, sure, 0.5))
    assert gyro.bias == pytest.approx(b, rel=0.02)
    both = np.linalg.inv(before) + np.linalg.inv(sure)
    assert gyro.bias_covariance == pytest.approx(np.linalg.inv(both))
    gyro.measure(START + 50 * MS, START + 50 * MS + WINDOW, noisy(lambda x: turning(x) + b))
    left = gyro.bias_covariance
    gyro.learn_bias(SeenBias(np.zeros(3), sure, 0.5))  # a tenth of the time later: a tenth of it
    gained = np.linalg.inv(gyro.bias_covariance) - np.linalg.inv(left)
    assert gained == pytest.approx(0.1 * np.linalg.inv(sure), rel=1e-6)


@pytest.mark.parametrize("bias", [2.0, 8.0])
def test_a_bias_is_learnt_though_it_is_far_from_what_is_expected(bias: float):
    gyro, b, sd = Gyro(CONFIG), np.radians([bias, 0.0, -bias]), np.radians(0.3)
    for t_start, t_end in windows(3.0):
        gyro.measure(t_start, t_end, noisy(lambda x: turning(x) + b, seconds=3.2))
        known = gyro.status.bias
        gyro.learn_bias(SeenBias(b - known.mean, sd**2 * np.eye(3), 0.5))
    assert np.degrees(gyro.bias - b) == pytest.approx(np.zeros(3), abs=0.2 * bias)


def test_windows_that_do_not_teach_the_bias_are_judged_all_the_same():
    gyro, found, taught = Gyro(CONFIG, by_windows=False), noisy(turning, seconds=3.2), []
    for t_start, t_end in windows(3.0):
        gyro.measure(t_start, t_end, found)
        before, state = gyro.bias, gyro.status.state
        gyro.learn(before + np.array([0.2, -0.2, 0.1]), np.radians(3.0) ** 2 * np.eye(3))
        taught.append((state, (gyro.bias != before).any()))
    assert (GyroState.USED, False) in taught
    assert (GyroState.USED, True) not in taught  # nor is it kept from those of one that is rejected
    assert (GyroState.REJECTED, True) in taught


def test_outliers_do_not_move_the_bias():
    gyro = Gyro(CONFIG)
    found = noisy(turning, seconds=5.2)
    rng = np.random.default_rng(2)
    sigma = np.radians(1.0)
    for k, (t_start, t_end) in enumerate(windows(5.0)):
        gyro.measure(t_start, t_end, found)
        wrong = np.radians([40.0, -30.0, 0.0]) if k % 3 == 2 else np.zeros(3)
        truth = turning(((t_start + t_end) / 2 - START) / S)
        gyro.learn(truth + wrong + sigma * rng.normal(size=3), sigma**2 * np.eye(3))
    assert np.degrees(np.abs(gyro.bias)).max() < 0.3
    assert gyro.status.state is GyroState.USED


def test_bias_drifts_with_time():
    gyro = Gyro(GyroConfig(bias_deg_s=0.5, bias_walk=0.1))
    found = readings(lambda x: 0.2, seconds=1.0)
    gyro.measure(START, START + WINDOW, found)
    before = gyro.bias_covariance[0, 0]
    gyro.measure(START + 100 * S, START + 100 * S + WINDOW, found)
    assert np.degrees(np.sqrt(gyro.bias_covariance[0, 0] - before)) == pytest.approx(1.0, rel=0.01)


def test_mounting_and_offset():
    config = GyroConfig(rotation="0,0,90", time_offset_ms=7.0)
    raw = readings(lambda x: np.array([1.0, 0.0, 0.2]) * x)
    found = GyroReadings.mounted(raw.t, raw.w, config.matrix(), config.time_offset_ns)
    got = Gyro(CONFIG).measure(START + 100 * MS, START + 200 * MS, found)
    np.testing.assert_allclose(got.w, [0.0, 0.143, 0.0286], atol=1e-9)


def test_roll_pitch_and_yaw_are_those_of_urdf():
    np.testing.assert_allclose(
        GyroConfig(rotation="90,0,90").matrix() @ [0, 1, 0], [0, 0, 1], atol=1e-12
    )
    np.testing.assert_array_equal(GyroConfig(rotation="mvsec").matrix(), np.eye(3))


@pytest.mark.parametrize("text", ["", "1,2", "a,b,c", "nan,0,0", "evk"])
def test_other_rotations_are_refused(text):
    with pytest.raises(InputError, match=r"^imu\.rotation: '.*' is no rotation; give .*, tf$"):
        load_config(overrides={"imu.rotation": text})


def test_tf_is_known_to_the_node_only():
    with pytest.raises(InputError, match="only the node has tf"):
        GyroConfig(rotation="tf").matrix()


def test_readings_that_do_not_advance_are_left_out():
    t = np.array([5, 6, 6, 3, 7, 5, 8], np.int64)
    found = GyroReadings.mounted(t, np.arange(21.0).reshape(7, 3), np.eye(3), 10)
    assert found.t.tolist() == [15, 16, 17, 18]
    assert found.w[:, 0].tolist() == [0, 3, 12, 18]


def test_a_window_has_the_readings_that_cover_it():
    t = np.arange(0, 100, 10) * MS
    found = GyroReadings(t, np.zeros((10, 3)))
    window = Window(25 * MS, 40 * MS, Events.empty()).with_gyro(found)
    assert window.gyro is not None
    assert (window.gyro.t // MS).tolist() == [20, 30, 40]
    part = window.since(32 * MS)
    assert (part.t_start, part.gyro) == (32 * MS, window.gyro)
    far = Window(200 * MS, 300 * MS, Events.empty()).with_gyro(found)
    assert far.gyro is not None and len(far.gyro) == 0
    near = Window(110 * MS, 120 * MS, Events.empty()).with_gyro(found)
    assert near.gyro is not None and (near.gyro.t // MS).tolist() == [90]
