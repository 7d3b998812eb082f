"""A camera at rest teaches the gyro's bias; one that moves does not."""

import numpy as np
import pytest
from gyro_motion import CONFIG, MS, START, WINDOW, S, noisy, readings, windows

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import GyroConfig
from emoflow_ros.core.estimate import Status
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.gyro import Gyro
from emoflow_ros.core.gyro_measurement import GyroReadings
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.lattice_estimator import LatticeEstimator

BIAS = np.radians([1.0, -0.8, 0.5])


def rest(found, seconds=1.0, config=CONFIG, start=START) -> Gyro:
    """Follow windows whose events show no motion. Each brings the readings of itself alone."""
    gyro = Gyro(config)
    for t_start, t_end in windows(seconds, start):
        gyro.measure(t_start, t_end, found.covering(t_start, t_end))
        gyro.learn_at_rest()
    return gyro


def claimed(gyro: Gyro):
    """Standard deviations of the bias, deg/s."""
    return np.degrees(np.sqrt(np.diag(gyro.bias_covariance)))


@pytest.mark.parametrize("seed", range(5))
def test_a_second_at_rest_teaches_the_bias(seed):
    gyro = rest(noisy(lambda x: BIAS, seed))
    assert np.degrees(np.abs(gyro.bias - BIAS)).max() < 0.1
    assert (claimed(gyro) < 0.25).all()
    assert (claimed(gyro) > 0.1).all()


def test_a_quarter_of_a_second_must_be_steady():
    found = noisy(lambda x: BIAS)
    assert (rest(found, 0.24).bias == 0).all()
    assert (rest(found, 0.33).bias != 0).all()


MOVING = {
    "sways by 0.5 deg/s at 1 Hz": noisy(lambda x: BIAS + np.radians(0.5) * np.sin(6.3 * x)),
    "trembles by 0.5 deg/s at 8 Hz": noisy(lambda x: BIAS + np.radians(0.5) * np.sin(50 * x)),
    "noise three times as large": noisy(lambda x: BIAS, density=0.03),
    "frozen": GyroReadings(*(lambda r: (r.t, 0 * r.w + BIAS))(readings(lambda x: 0.0))),
    "not finite": GyroReadings(*(lambda r: (r.t, r.w + np.nan))(readings(lambda x: 0.0))),
    "an even turn of 20 deg/s": noisy(lambda x: np.radians(20.0)),
}


@pytest.mark.parametrize("name", MOVING)
def test_a_gyro_that_is_not_steady_teaches_nothing(name):
    gyro = rest(MOVING[name])
    assert (gyro.bias == 0).all()
    assert claimed(gyro) == pytest.approx(1.0, rel=0.01)


def test_motion_between_rests_interrupts_them():
    """Still for 0.2 s, turning for 0.2 s, and so on."""
    found = noisy(lambda x: BIAS + np.radians(5.0) * (int(x / 0.2) % 2))
    assert (rest(found).bias == 0).all()


def test_time_that_goes_back_begins_anew():
    gyro = rest(noisy(lambda x: BIAS), 0.24)
    again = noisy(lambda x: BIAS, seed=1, start=START - 100 * S)
    gyro.measure(START - 100 * S, START - 100 * S + WINDOW, again)
    gyro.learn_at_rest()
    assert (gyro.bias == 0).all()


@pytest.mark.parametrize("still", [True, False])
def test_a_camera_at_rest_does_not_turn_once_its_bias_is_known(still):
    """Too few events in each window; the same without rest keeps the bias in w."""
    sway = 0.0 if still else np.radians(0.5)
    found = noisy(lambda x: BIAS + sway * np.sin(20 * x), seconds=1.2)
    estimator = LatticeEstimator(
        Camera(64, 48, 60.0, 60.0, 32.0, 24.0), LatticeConfig(), imu=CONFIG
    )
    x = np.arange(20, dtype=np.uint16)
    for t_start, t_end in windows(1.0):
        t = t_start + np.arange(20) * MS
        events = Events(x, x, t, np.ones(20, np.bool_))
        estimate = estimator.estimate(Window(t_start, t_end, events).with_gyro(found))
        assert estimate.status is Status.OK
        assert estimate.quality.stop_reason == "too_few_events"
    off = np.degrees(np.linalg.norm(estimate.angular))
    assert off < 0.2 if still else off > 1.0


def test_a_bias_that_is_larger_than_expected_is_learnt_if_the_configuration_says_so():
    found = noisy(lambda x: 6 * BIAS)
    assert (rest(found).bias == 0).all()  # 6 deg/s may as well be an even turn
    gyro = rest(found, config=GyroConfig(use="auto", bias_deg_s=5.0))
    assert np.degrees(np.abs(gyro.bias - 6 * BIAS)).max() < 0.1
