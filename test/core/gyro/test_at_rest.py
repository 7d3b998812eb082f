"""A camera at rest teaches the gyro's bias; one that moves does not."""

import numpy as np
import pytest
from gyro_motion import CONFIG, MS, START, S, noisy, readings, turning, windows

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.gyro.checks import SteadyWatch
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.core.types.gyro import GyroReadings

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
    assert (claimed(gyro) < 0.16).all()


def test_a_long_rest_counts_as_one_measurement_in_ten_seconds():
    """It could be an even turn that the events do not show, the same one in all windows."""
    gyro = rest(noisy(lambda x: BIAS, seconds=10.2), 10.0)
    assert (claimed(gyro) > 0.1).all()


def test_rest_after_motion_counts_at_once():
    gyro = Gyro(CONFIG)
    b = np.radians([2.0, 0.0, 0.0])
    found = noisy(lambda x: b + (turning(x) if x < 1.0 else 0.0), seconds=2.2)
    for t_start, t_end in windows(2.0):
        gyro.measure(t_start, t_end, found)
        if t_end < START + S:
            middle = turning(((t_start + t_end) / 2 - START) / S)
            gyro.learn(middle, np.radians(3.0) ** 2 * np.eye(3))
        elif t_start > START + S:
            gyro.learn_at_rest()
    assert np.degrees(np.abs(gyro.bias - b)).max() < 0.1


def test_half_a_second_must_be_steady():
    found = noisy(lambda x: BIAS)
    assert (rest(found, 0.46).bias == 0).all()
    assert (rest(found, 0.7).bias != 0).all()


MOVING = {
    "sways by 0.5 deg/s at 1 Hz": noisy(lambda x: BIAS + np.radians(0.5) * np.sin(6.3 * x)),
    "trembles by 0.5 deg/s at 8 Hz": noisy(lambda x: BIAS + np.radians(0.5) * np.sin(50 * x)),
    "turns ever faster": noisy(lambda x: BIAS + np.radians(0.5) * x),
    "still for 0.4 s, turning for 0.1 s, and so on": noisy(
        lambda x: BIAS + np.radians(5.0) * (x % 0.5 > 0.4)
    ),
    "noise three times as large": noisy(lambda x: BIAS, density=0.03),
    "frozen": GyroReadings(*(lambda r: (r.t, 0 * r.w + BIAS))(readings(lambda x: 0.0))),
    "not finite": GyroReadings(*(lambda r: (r.t, r.w + np.nan))(readings(lambda x: 0.0))),
}


@pytest.mark.parametrize("name", MOVING)
def test_a_gyro_that_is_not_steady_teaches_nothing(name):
    gyro = rest(MOVING[name])
    assert (gyro.bias == 0).all()
    assert claimed(gyro) == pytest.approx(1.0, rel=0.01)


@pytest.mark.parametrize(("turn", "is_learnt"), [(2.0, True), (20.0, False)])
def test_an_even_turn_that_the_events_miss_is_taken_for_a_bias_if_that_could_be(turn, is_learnt):
    gyro = rest(noisy(lambda x: np.radians([turn, 0.0, 0.0])))
    assert (np.degrees(gyro.bias[0]) > 1.9) == is_learnt


def test_a_gyro_that_is_said_to_be_noisy_is_never_steady():
    """Its limits would let motion pass."""
    config = GyroConfig(use="auto", noise=0.3)
    sway = noisy(lambda x: BIAS + np.radians(2.0) * np.sin(3.1 * x))
    assert (rest(sway, config=config).bias == 0).all()
    assert (rest(noisy(lambda x: BIAS, density=0.3), config=config).bias == 0).all()


def test_steady_readings_that_are_not_numbers_are_not_steady():
    watch = SteadyWatch()
    found = noisy(lambda x: BIAS, seed=1)
    for t in range(START + 100 * MS, START + 900 * MS, 50 * MS):
        broken = GyroReadings(found.t, np.where(found.t[:, None] == START, np.nan, found.w))
        mean = watch.take(broken, t, np.radians(0.01))
        assert (mean is not None) == (t >= START + 550 * MS)  # 0.5 s from 0.05 s on


def test_the_mean_of_the_steady_time_is_the_bias():
    """A window of 0.6 s, of which the camera turned in the first 0.05 s."""
    found = noisy(lambda x: BIAS + np.radians(3.0) * (x < 0.05), seconds=1.2)
    gyro = Gyro(CONFIG)
    for end in (600, 700, 800, 900):
        gyro.measure(START + (end - 600) * MS, START + end * MS, found)
        gyro.learn_at_rest()
    assert np.degrees(np.abs(gyro.bias - BIAS)).max() < 0.1


def test_after_a_jump_back_in_time_a_second_at_rest_teaches_the_bias_again():
    gyro = rest(noisy(lambda x: BIAS), 0.4)
    before = START - 100 * S
    found = noisy(lambda x: BIAS, seed=1, start=before)
    for k, (t_start, t_end) in enumerate(windows(1.0, before)):
        gyro.measure(t_start, t_end, found.covering(t_start, t_end))
        gyro.learn_at_rest()
        assert (gyro.bias == 0).all() or k > 5
    assert np.degrees(np.abs(gyro.bias - BIAS)).max() < 0.1


@pytest.mark.parametrize("still", [True, False])
@pytest.mark.parametrize(("count", "reason"), [(20, "too_few_events"), (4000, "no_motion")])
def test_a_camera_at_rest_does_not_turn_once_its_bias_is_known(still, count, reason):
    """Too few events in each window, or noise; the same without rest keeps the bias in w."""
    sway = 0.0 if still else np.radians(0.5)
    found = noisy(lambda x: BIAS + sway * np.sin(20 * x), seconds=1.2)
    camera = Camera(240, 180, 200.0, 200.0, 120.0, 90.0)
    estimator = LatticeEstimator(camera, LatticeConfig(), Gyro(CONFIG))
    rng = np.random.default_rng(0)
    for t_start, t_end in windows(1.0):
        x, y = (rng.integers(0, n, count).astype(np.uint16) for n in camera.size)
        t = np.sort(rng.integers(t_start, t_end, count))
        events = Events(x, y, t, rng.random(count) < 0.5)
        estimate = estimator.estimate(Window(t_start, t_end, events).with_gyro(found))
        assert estimate.status is Status.OK
        assert estimate.quality.stop_reason == reason
    off = np.degrees(np.linalg.norm(estimate.angular))
    assert off < 0.2 if still else off > 1.0


def test_a_bias_that_is_larger_than_expected_is_learnt_if_the_configuration_says_so():
    found = noisy(lambda x: 6 * BIAS)
    assert (rest(found).bias == 0).all()  # 6 deg/s may as well be an even turn
    gyro = rest(found, config=GyroConfig(use="auto", bias_deg_s=5.0))
    assert np.degrees(np.abs(gyro.bias - 6 * BIAS)).max() < 0.1
