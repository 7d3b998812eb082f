import pytest

from emoflow_ros.core.types.twist import SpeedLog

MS = 1_000_000
START = 1_500_000_000_123_456_789


@pytest.fixture
def log() -> SpeedLog:
    made = SpeedLog()
    for k in range(5):  # 2 m/s, faster by 1 m/s every 100 ms
        made.add(START + 100 * MS * k, 2.0 + k)
    return made


def test_speed_is_linear_between_two_times(log: SpeedLog) -> None:
    assert log.at(START + 100 * MS, 50 * MS) == 3.0
    assert log.at(START + 130 * MS, 50 * MS) == pytest.approx(3.3)
    assert log.at(START + 301 * MS, 50 * MS) == pytest.approx(5.01)


def test_outside_of_the_times_the_nearest_counts_until_it_is_too_old(log: SpeedLog) -> None:
    assert log.at(START + 450 * MS, 50 * MS) == 6.0
    assert log.at(START + 451 * MS, 50 * MS) is None
    assert log.at(START - 50 * MS, 50 * MS) == 2.0
    assert log.at(START - 51 * MS, 50 * MS) is None


def test_gap_wider_than_the_age_has_no_speed(log: SpeedLog) -> None:
    log.add(START + 1400 * MS, 16.0)
    assert log.at(START + 900 * MS, 400 * MS) is None
    assert log.at(START + 900 * MS, 500 * MS) == pytest.approx(11.0)


def test_nothing_was_said() -> None:
    assert SpeedLog().at(START, 10**12) is None


def test_earlier_time_begins_anew(log: SpeedLog) -> None:
    log.add(START - 1000 * MS, 9.0)
    assert log.at(START + 100 * MS, 50 * MS) is None
    assert log.at(START - 1000 * MS, 50 * MS) == 9.0


def test_old_speeds_are_forgotten() -> None:
    log = SpeedLog()
    for k in range(1500):
        log.add(k * MS, float(k))
    assert log.at(499 * MS, 0) is None
    assert log.at(500 * MS, 0) == 500.0
