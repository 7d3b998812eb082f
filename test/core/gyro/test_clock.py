"""The offset between a gyro's clock and the events', found from the turning of the camera."""

import numpy as np
import pytest
from gyro_motion import MS, START, S

from emoflow_ros.core.gyro.clock import GyroClock, find_offset
from emoflow_ros.core.types.gyro import GyroReadings

STRIDE, LENGTH = 67 * MS, 60 * MS
BIAS = np.radians([2.0, -1.0, 3.0])


def varied(t):
    """Angular velocity (N, 3) of a camera in a hand."""
    x = ((t - START) / S)[:, None]
    return 0.4 * np.sin(2 * np.pi * x * [0.7, 1.1, 1.9] + [0.0, 1.0, 2.0])


def swinging(t):
    """A pendulum of 0.5 s."""
    x = ((t - START) / S)[:, None]
    return 0.4 * np.sin(2 * np.pi * 2.0 * x) * [1.0, 0.0, 0.0]


def even(t):
    return np.tile([0.4, 0.0, 0.0], (len(t), 1))


def still(t):
    return np.zeros((len(t), 3))


def readings(motion=varied, offset=0, seconds=7.0, seed=0):
    """Readings of 1000 Hz whose stamps lack `offset` ns."""
    t = START + np.arange(0, round(seconds * S), MS)
    noise = np.radians(0.3) * np.random.default_rng(seed).normal(size=(len(t), 3))
    return GyroReadings(t - offset, motion(t) + noise + BIAS)


def windows(motion=varied, count=60, first=1200 * MS, seed=1):
    """Middle thirds of windows, and what the events tell, every tenth of them wrongly."""
    starts = START + first + STRIDE * np.arange(count)
    rng = np.random.default_rng(seed)
    w = motion(starts + LENGTH // 2) + np.radians(2.0) * rng.normal(size=(count, 3))
    w[::10] += np.radians(30.0) * rng.normal(size=w[::10].shape)
    return starts + LENGTH // 3, starts + 2 * LENGTH // 3, w


@pytest.mark.parametrize("offset_ms", [-1000, -400, -37, 0, 250, 1000])
@pytest.mark.parametrize("seed", range(3))
def test_the_offset_is_found_to_some_milliseconds(offset_ms, seed):
    """A window's w is 2 deg/s off and changes by 190 deg/s^2: 60 of them tell it to 1.4 ms."""
    found = find_offset(readings(offset=offset_ms * MS, seed=seed), *windows(seed=seed))
    assert found is not None
    assert abs(found - offset_ms * MS) <= 4 * MS


@pytest.mark.parametrize("motion", [swinging, even, still])
@pytest.mark.parametrize("seed", range(5))
def test_a_motion_that_looks_alike_at_several_times_tells_no_offset(motion, seed):
    assert find_offset(readings(motion, seed=seed), *windows(motion, seed=seed)) is None


@pytest.mark.parametrize("turned", [np.diag([1.0, -1.0, -1.0]), 57.3 * np.eye(3), np.zeros((3, 3))])
def test_wrong_axes_and_units_tell_no_offset(turned):
    found = readings()
    assert find_offset(GyroReadings(found.t, found.w @ turned), *windows()) is None


def test_the_gyro_of_another_body_tells_no_offset():
    other = readings(lambda t: varied(t + 777 * S)[:, ::-1])
    assert find_offset(other, *windows()) is None


def test_a_clock_that_is_set_meanwhile_tells_no_offset():
    before, after = readings(offset=0), readings(offset=20 * MS)
    middle = START + 1200 * MS + 30 * STRIDE
    first, rest = before.t < middle, after.t + 20 * MS >= middle
    both = GyroReadings(
        np.concatenate([before.t[first], after.t[rest] + 40 * MS]),
        np.concatenate([before.w[first], after.w[rest]]),
    )
    assert find_offset(both, *windows()) is None


def test_few_windows_tell_no_offset():
    assert find_offset(readings(), *windows(count=29)) is None
    assert find_offset(readings(), *windows(count=60, first=0)) is not None  # 45 are covered
    assert find_offset(readings(seconds=3.0), *windows()) is None
    assert find_offset(readings(seconds=0.0), *windows()) is None
    broken = readings()
    broken.w[2000] = np.nan
    assert find_offset(broken, *windows()) is None


def noted(*apart_ms, delay_ms=0):
    clock = GyroClock()
    for apart in apart_ms:
        clock.note(apart * MS, delay_ms * MS)
    return clock


@pytest.mark.parametrize(
    ("apart_ms", "delay_ms", "is_doubtful"),
    [
        ([], 0, False),
        ([30], 0, False),
        ([200], 0, False),  # a busy node
        ([200, 180], 200, True),  # the stamps confirm it
        ([-200], -200, True),
        ([400], 0, True),
        ([400, 20, *[400] * 19], 0, False),  # events that waited
        ([400, 20, *[400] * 20], 0, True),
        ([10], 400, False),  # events that come late, or a gyro on the sensor's clock
        ([1200], 1200, False),  # beyond what is searched for
    ],
)
def test_times_that_are_apart_for_long_are_doubtful(apart_ms, delay_ms, is_doubtful):
    assert noted(*apart_ms, delay_ms=delay_ms).is_doubtful is is_doubtful


def test_what_is_found_is_used_until_the_times_move_again():
    clock = noted(*[400] * 20, delay_ms=400)
    for start, end, w in zip(*windows(), strict=True):
        clock.add(start - LENGTH // 3, end + LENGTH // 3, w)
    assert clock.search(readings(seconds=2.0)) is False
    assert clock.is_doubtful
    assert clock.search(readings(offset=-400 * MS)) is True
    assert abs(clock.offset_ns + 400 * MS) <= 4 * MS
    assert not clock.is_doubtful
    for _ in range(20):
        clock.note(500 * MS, 400 * MS)
    assert not clock.is_doubtful
    for _ in range(20):
        clock.note(20 * MS, 400 * MS)  # the gyro's clock was set
    assert clock.is_doubtful
    assert clock.search(readings()) is False  # not by the windows of before
