"""What benchmarks/stream.py makes of what a subscriber heard."""

import math

import numpy as np
import pytest

from benchmarks._stream_figures import (
    Heard,
    Stream,
    errors,
    figures,
    intervals,
    longest_silence,
    rows,
)
from benchmarks.stream import parse_seeds
from emoflow_ros.errors import InputError


def speed(t: float) -> float:
    """Moves in the first second and rests in the next."""
    return 50.0 if t < 1.0 else 0.0


def test_intervals_count_from_the_first_twist_on_by_what_the_camera_does() -> None:
    times = [0.21, 0.25, 0.41, *np.arange(1.05, 1.95, 0.1)]
    found = intervals(times, 2.0, speed)
    assert found == {"moving": (7, 1), "rest": (10, 9)}  # 0.3 to 1 s; 1 to 2 s


def test_silence_lasts_until_the_next_twist_or_the_end() -> None:
    assert longest_silence([0.2, 0.5, 0.6], 1.0) == pytest.approx(0.4)
    assert longest_silence([0.2, 0.9], 1.0) == pytest.approx(0.7)
    assert longest_silence([], 1.0) == math.inf


def heard(error: float, sigma: float, times: list[float]) -> Heard:
    w = np.array([error, 0.0, 0.0])
    covariance = sigma**2 * np.eye(3)
    return Heard(times, [w] * len(times), [covariance] * len(times))


def test_figures_of_recordings_and_their_targets() -> None:
    times = list(np.arange(0.2, 2.0, 0.05))
    right, wrong = heard(0.1, 0.06, times), heard(0.4, 0.1, times)
    made = [
        Stream(seed, 2.0, times, now, right, ["ok", "still"])
        for seed, now in ((0, right), (1, wrong))
    ]
    found = [figures(one, speed, lambda t: np.zeros(3)) for one in made]
    assert found[0]["now"]["nees"] == pytest.approx((0.1 / 0.06) ** 2 / 3)
    assert found[0]["now"]["missed_percent"] == 0 and found[1]["now"]["missed_percent"] == 100
    assert found[1]["statuses"] == {"ok": 1, "still": 1}
    by_name = {row.figure: row for row in rows(found)}
    assert by_name["100 ms intervals with a twist, moving, %"].result == 100
    assert by_name["longest silence, s"].verdict == "met"
    assert by_name["recordings with a NEES of w of 0.5 to 2, now, %"].result == 50
    assert by_name["recordings with a NEES of w of 0.5 to 2, windows, %"].verdict == "met"
    assert by_name["3-sigma misses of w, now, %"].result == 50
    assert by_name["the same by axis, now, %"].result == pytest.approx(100 / 6)  # x of every second


def test_an_error_may_exceed_its_deviation_along_no_axis() -> None:
    two = Heard([0.5, 0.6], [np.full(3, 0.29), np.array([0.0, 0.0, 0.31])], [0.01 * np.eye(3)] * 2)
    _, missed, by_axis = errors(two, lambda t: np.zeros(3))
    assert missed.tolist() == [True, True]
    assert by_axis.tolist() == [[False, False, False], [False, False, True]]


def test_a_recording_without_a_twist_is_not_left_out() -> None:
    silent = figures(Stream(0, 2.0, [], Heard(), Heard(), []), speed, lambda t: np.zeros(3))
    by_name = {row.figure: row for row in rows([silent])}
    assert by_name["100 ms intervals with a twist, moving, %"].result == 0
    assert by_name["longest silence, s"].verdict == "not measured"
    assert by_name["windows dropped, %"].result is None


def test_dropped_windows_are_counted_over_all_recordings() -> None:
    found = [
        figures(Stream(seed, 2.0, [], Heard(), Heard(), told), speed, lambda t: np.zeros(3))
        for seed, told in enumerate((["ok", "dropped", "still"], ["ok"]))
    ]
    by_name = {row.figure: row for row in rows(found)}
    assert by_name["windows dropped, %"].result == 25


def test_seeds_are_a_range_with_both_ends() -> None:
    assert list(parse_seeds("0-7")) == list(range(8))
    for wrong in ("7", "7-3", "a-b"):
        with pytest.raises(InputError, match="give for example 0-7"):
            parse_seeds(wrong)
