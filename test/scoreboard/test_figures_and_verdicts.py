"""The scoreboard's figures against plain loops and by hand, and its verdicts at their borders."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from scoreboard_tables import MS, NAN, random_table, row, silent, slow_figures, towards

from benchmarks.scoreboard.figures import errors_of, figures_of
from benchmarks.scoreboard.uncertainty import direction_errors, normalised_squares
from benchmarks.scoreboard.verdicts import judge, rate
from benchmarks.scoreboard.windows import make_windows


def figures(*rows):
    return figures_of(make_windows(list(rows)))


GOOD = replace(figures(row(), row(start=1)), nees_v=1.0)


@pytest.mark.parametrize("seed", range(5))
def test_figures_are_those_of_plain_loops(seed):
    windows = random_table(seed)
    found, slow = asdict(figures_of(windows)), slow_figures(windows)
    assert {name: found[name] for name in slow} == pytest.approx(slow, rel=1e-6)


def test_a_good_recording_by_hand():
    assert GOOD.w_rms == pytest.approx(1.0)
    assert GOOD.w_percent == pytest.approx(10.0)
    assert GOOD.nees_w == pytest.approx(1 / 3)
    assert (GOOD.epe_percent, GOOD.v_median, GOOD.confident_wrong) == (5.0, 0.0, 0.0)
    assert GOOD.settled_s == pytest.approx(0.135)


def test_without_any_window_nothing_is_known_and_nothing_judged():
    verdict = judge(figures())
    assert set(verdict.criteria.values()) == {None}


def test_a_silent_camera_at_rest_is_accurate_and_consistent():
    verdict = judge(figures(*[silent(moved_px=0.0, parallax_px=0.0)] * 3))
    assert verdict.accurate
    assert verdict.consistent
    assert verdict.criteria["coverage"] is None


def test_a_moving_camera_without_any_estimate_is_neither_accurate_nor_consistent():
    verdict = judge(figures(*[silent()] * 3))
    assert verdict.missed == ["coverage", "answer"]
    assert not verdict.accurate
    assert not verdict.consistent
    assert judge(figures(silent(), row())).criteria["answer"] is True


def test_a_wrong_error_is_beyond_three_sigma_and_beyond_the_least_error():
    wrong = {"angular": np.radians([16.0, 0, 0])}  # 6 deg/s off
    sure, unsure = np.radians(1.9) ** 2 * np.eye(3), np.radians(2.1) ** 2 * np.eye(3)
    assert figures(row(**wrong, angular_covariance=sure)).confident_wrong == 100.0
    assert figures(row(**wrong, angular_covariance=unsure)).confident_wrong == 0.0
    near = {"angular": np.radians([14.9, 0, 0])}
    assert figures(row(**near, angular_covariance=sure / 100)).confident_wrong == 0.0


def test_only_the_sigma_along_the_error_counts():
    covariance = np.radians(np.diag([1.0, 50.0, 50.0])) ** 2
    wrong = row(angular=np.radians([20.0, 0, 0]), angular_covariance=covariance)
    assert errors_of(make_windows([wrong])).w_sigma[0] == pytest.approx(1.0)
    assert figures(wrong).confident_wrong_w == 100.0


@pytest.mark.parametrize(("degrees", "share"), [(8.9, 0.0), (21.0, 100.0), (180.0, 100.0)])
def test_a_confident_direction_that_is_wrong(degrees, share):
    found = figures(row(linear=towards(degrees), linear_covariance=1e-4 * np.eye(3)))
    assert found.v_median == pytest.approx(degrees)
    assert found.confident_wrong_v == share


def test_the_nees_of_right_covariances_is_one():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    errors = rng.normal(size=(20_000, 3)) @ root.T
    covariances = np.broadcast_to(root @ root.T, (20_000, 3, 3))
    assert normalised_squares(errors, covariances).mean() == pytest.approx(1.0, abs=0.03)


def test_a_covariance_of_zero_is_many_sigmas_and_no_failure():
    assert normalised_squares(np.full((1, 3), 0.01), np.zeros((1, 3, 3)))[0] > 1e3


def test_an_error_of_exactly_zero_has_no_nees():
    errors = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    squares = normalised_squares(errors, np.broadcast_to(0.01 * np.eye(3), (2, 3, 3)))
    assert np.isnan(squares[0])
    assert squares[1] == pytest.approx(1 / 3)


def test_a_camera_at_rest_that_is_told_so_is_consistent():
    found = figures(row(angular=np.zeros(3), true_angular=np.zeros(3), moved_px=0.0))
    assert math.isnan(found.nees_w)
    assert judge(found).criteria["nees"] is not False


def test_direction_errors_need_both_directions():
    linear = np.array([[0, 0, 1.0], [NAN] * 3, [0, 0, 1.0]])
    true = np.array([[1.0, 0, 0], [0, 0, 1.0], [NAN] * 3])
    errors, _ = direction_errors(linear, true, np.zeros((3, 3, 3)))
    assert np.linalg.norm(errors[0]) == pytest.approx(math.pi / 2)
    assert np.isnan(errors[1:]).all()


def test_a_gyro_that_reads_too_little_is_scaled_within_its_limit():
    scaled = row(angular=np.radians([11.5, 0, 0]))
    assert figures_of(make_windows([scaled]), 1.25).w_rms == pytest.approx(0.0, abs=1e-9)
    beyond = figures_of(make_windows([row(angular=np.radians([15.0, 0, 0]))]), 1.25)
    assert beyond.w_scale == 1.25
    assert beyond.w_rms == pytest.approx(2.5)
    assert beyond.w_raw_rms == pytest.approx(5.0)


def test_w_is_settled_once_it_stays_good_from_both_starts():
    good = [row(t_end=k * 100 * MS) for k in (2, 3)]
    bad = row(t_end=100 * MS, angular=np.radians([20.0, 0, 0]))
    late = row(start=1, t_begin=100 * MS, t_end=200 * MS)
    assert figures(bad, *good, late).settled_s == pytest.approx(0.2)
    assert figures(*good, bad, late).settled_s == math.inf


@pytest.mark.parametrize(
    ("criterion", "met", "missed"),
    [
        ("coverage", {"covered_moving": 90.0}, {"covered_moving": 89.9}),
        ("epe", {"epe_px": 0.7, "truth_px": 5.0}, {"epe_px": 0.71, "truth_px": 5.0}),
        ("epe", {"epe_px": 1.79, "truth_px": 20.0}, {"epe_px": 1.81, "truth_px": 20.0}),
        ("w", {"w_rms": 2.5, "w_true_rms": 10.0}, {"w_rms": 2.51, "w_true_rms": 10.0}),
        ("w", {"w_rms": 8.0, "w_true_rms": 100.0}, {"w_rms": 8.01, "w_true_rms": 100.0}),
        ("v", {"v_median": 8.0}, {"v_median": 8.1}),
        ("v", {"v_median": NAN, "v_given": NAN}, {"v_median": NAN, "v_given": 0.0}),
        ("answer", {"estimates": 1}, {"estimates": 0}),
        ("still", {"still_wrong": 0.0}, {"still_wrong": 0.1}),
        ("nees", {"nees_w": 3.0, "nees_v": 0.3}, {"nees_w": 3.0, "nees_v": 0.29}),
        ("nees", {"nees_w": 0.3, "nees_v": NAN}, {"nees_w": 3.1, "nees_v": NAN}),
        ("confident", {"confident_wrong": 1.0}, {"confident_wrong": 1.1}),
        ("lost", {"lost": 0.0}, {"lost": 0.1}),
    ],
)
def test_criteria_at_their_borders(criterion, met, missed):
    assert judge(replace(GOOD, **met)).criteria[criterion] is not False
    verdict = judge(replace(GOOD, **missed))
    assert verdict.missed == [criterion]
    assert verdict.accurate == (criterion not in ("coverage", "epe", "w", "v"))
    assert verdict.consistent != verdict.accurate


def test_an_estimate_at_rest_may_be_off_as_far_as_its_covariance_says():
    rest = {"moved_px": 0.0, "parallax_px": 0.0, "true_angular": np.zeros(3)}
    off = {**rest, "angular": np.radians([4.0, 0, 0])}
    wide = np.radians(2.0) ** 2 * np.eye(3)
    assert figures(row(**off)).still_wrong == 100.0
    assert figures(row(**off, angular_covariance=wide)).still_wrong == 0.0
    assert figures(silent(**rest)).still_wrong == 0.0


def test_flow_is_lost_beyond_half_of_the_way_of_moving_windows():
    assert figures(row(epe_px=5.1)).lost == 100.0
    assert figures(row(epe_px=5.0)).lost == 0.0
    assert math.isnan(figures(row(epe_px=5.1, moved_px=2.0)).lost)


def test_rates_count_what_can_be_judged():
    assert rate([True, False, None, True]) == pytest.approx(200 / 3)
    assert math.isnan(rate([None]))
