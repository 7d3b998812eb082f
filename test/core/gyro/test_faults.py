"""Faults of a gyro: each is noticed within half a second, and so is its end."""

import numpy as np
import pytest
from gyro_motion import CONFIG, MS, START, STRIDE, WINDOW, S, follow, noisy, readings, turning

from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.core.types.gyro import GyroReadings, GyroState, GyroStatus

FROM, TO = START + 1 * S, START + 2 * S


def states(found, seconds=3.0, config=CONFIG):
    """End of each window in ms after the start, and the gyro's status after it."""
    gyro = Gyro(config)
    seen = []
    for t in range(START, START + round(seconds * S) - WINDOW, STRIDE):
        measured = gyro.measure(t, t + WINDOW, found)
        assert (measured is None) is (gyro.status.state is not GyroState.USED)
        seen.append(((t + WINDOW - START) // MS, gyro.status))
    return seen


def changed(fault):
    """Readings of three seconds with a fault in the second one."""
    found = noisy(turning, seconds=3.2)
    inside = (found.t >= FROM) & (found.t < TO)
    return fault(found, inside)


def put(found, inside, value):
    w = found.w.copy()
    w[inside] = value
    return GyroReadings(found.t, w)


FAULTS = {
    "silence": (
        lambda found, inside: GyroReadings(found.t[~inside], found.w[~inside]),
        {"readings end before the window", "no readings", "a gap in the readings' time"},
    ),
    "freeze": (
        lambda found, inside: put(found, inside, found.w[inside][0]),
        {"readings that do not change"},
    ),
    "zeros": (lambda found, inside: put(found, inside, 0.0), {"readings that do not change"}),
    "saturation": (
        lambda found, inside: put(found, inside, np.radians(2000.0)),
        {"readings at the end of the range"},
    ),
    "nan": (lambda found, inside: put(found, inside, np.nan), {"readings that are not finite"}),
    "jump in time": (
        lambda found, inside: GyroReadings.mounted(
            np.where(inside, found.t - 60 * S, found.t), found.w, np.eye(3)
        ),
        {"readings end before the window", "no readings", "a gap in the readings' time"},
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_noticed_and_so_is_its_end(name):
    fault, reasons = FAULTS[name]
    seen = states(changed(fault))
    for end, status in seen:
        if end <= 1000 or end > 2000 + WINDOW // MS + 30:
            assert status == GyroStatus(GyroState.USED), end
        elif 1100 < end <= 2000:  # a tenth of a second after it began
            assert status.state is GyroState.REJECTED, end
            assert status.reason in reasons


def test_a_late_gyro_is_held_for_a_moment_and_then_missed():
    found = readings(turning)
    ends = START + 500 * MS
    gyro = Gyro(CONFIG)
    early = gyro.measure(ends - WINDOW, ends, found)
    cut = GyroReadings(found.t[found.t < ends - 20 * MS], found.w[found.t < ends - 20 * MS])
    late = gyro.measure(ends - WINDOW, ends, cut)
    assert np.degrees(np.abs(late.w - early.w)).max() < 2.0
    assert late.covariance[0, 0] > early.covariance[0, 0] + np.radians(1.0) ** 2
    later = GyroReadings(found.t[found.t < ends - 31 * MS], found.w[found.t < ends - 31 * MS])
    assert gyro.measure(ends - WINDOW, ends, later) is None
    assert str(gyro.status) == "rejected (readings end before the window)"


def test_without_a_gyro_there_is_nothing_to_reject():
    gyro = Gyro(CONFIG)
    assert gyro.measure(START, START + WINDOW, None) is None
    assert str(gyro.status) == "none"
    gyro.learn(np.zeros(3), np.eye(3))
    assert not gyro.bias.any()


def test_readings_on_another_clock_are_none():
    found = noisy(turning, start=S)
    assert {str(status) for _, status in states(found)} == {"rejected (no readings)"}


def test_a_slow_gyro_without_noise_is_not_frozen_while_it_turns():
    found = readings(turning, seconds=3.2, rate=100)
    assert all(status.state is GyroState.USED for _, status in states(found))


MATRICES = {
    "axis x inverted?": np.diag([-1.0, 1.0, 1.0]),
    "the camera's axes are (+y, +x, +z) of the readings?": np.array(
        [[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]
    ),
    "readings in deg/s?": 57.3 * np.eye(3),
    "readings converted to rad/s twice?": np.eye(3) / 57.3,
}


@pytest.mark.parametrize("name", MATRICES)
def test_a_gyro_that_never_agreed_is_rejected_soon(name):
    matrix = MATRICES[name]
    gyro = Gyro(GyroConfig(range_deg_s=0.0))
    found = noisy(lambda x: matrix @ turning(x), seconds=5.2)
    used = follow(gyro, found, turning, 5.0)
    assert all(m is None for m in used[3 * S // (2 * STRIDE) :])
    assert gyro.status.state is GyroState.REJECTED
    assert gyro.status.reason.startswith("gyro and events disagree: ")
    assert gyro.status.reason.endswith(f" % of windows, {name}")
    assert gyro.disagreement > 0.5


def test_a_gyro_that_agreed_survives_a_second_of_wrong_events():
    gyro = Gyro(CONFIG)
    found = noisy(turning, seconds=6.2)
    follow(gyro, found, turning, 3.0)
    bias = gyro.bias
    for t in range(START + 3 * S, START + 4 * S, STRIDE):
        assert gyro.measure(t, t + WINDOW, found) is not None
        gyro.learn(np.array([1.0, -1.0, 0.5]), np.radians(1.0) ** 2 * np.eye(3))
    np.testing.assert_allclose(gyro.bias, bias, atol=np.radians(0.2))


def test_a_rejected_gyro_comes_back_when_it_agrees_again():
    gyro = Gyro(CONFIG)
    found = noisy(
        lambda x: (np.diag([-1.0, -1, 1]) if x < 4 else np.eye(3)) @ turning(x), seconds=10.2
    )
    used = follow(gyro, found, turning, 10.0)
    half = 4 * S // STRIDE
    assert used[half - 3] is None
    assert all(m is not None for m in used[2 * half :])
    assert gyro.status.state is GyroState.USED


def test_a_large_bias_is_learnt_while_the_gyro_is_rejected():
    """A bias of 9 deg/s where half a degree was expected."""
    b = np.radians([9.0, 0.0, -9.0])
    gyro = Gyro(GyroConfig(bias_deg_s=0.5))

    def slowly(x):
        return 0.3 * turning(x)

    used = follow(gyro, noisy(lambda x: slowly(x) + b, seconds=25.2), slowly, 25.0)
    assert used[S // STRIDE] is None
    assert gyro.status.state is GyroState.USED
    assert np.degrees(np.abs(gyro.bias - b)).max() < 0.4


def test_the_same_windows_and_readings_give_the_same():
    found = noisy(turning, seconds=5.2)
    first, second = (follow(Gyro(CONFIG), found, turning, 5.0) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.coefficients, b.coefficients)
        np.testing.assert_array_equal(a.covariances, b.covariances)


def test_only_the_readings_of_the_window_count():
    found = noisy(turning, seconds=3.2)
    whole = Gyro(CONFIG).measure(START + S, START + S + WINDOW, found)
    attached = found.covering(START + S, START + S + WINDOW)
    alone = Gyro(CONFIG).measure(START + S, START + S + WINDOW, attached)
    np.testing.assert_array_equal(whole.coefficients, alone.coefficients)


def test_time_that_starts_anew_keeps_the_bias():
    b = np.radians([1.0, -1.0, 0.5])
    gyro = Gyro(CONFIG)
    found = noisy(lambda x: turning(x) + b, seconds=8.2)
    follow(gyro, found, turning, 8.0)
    learnt = gyro.bias
    assert gyro.measure(START, START + WINDOW, found) is not None
    np.testing.assert_array_equal(gyro.bias, learnt)
