"""The gain of information against closed forms and another implementation."""

import math

import numpy as np
import pytest
from scipy.special import gammaln
from scipy.stats import multivariate_normal, multivariate_t
from scoreboard_tables import NAN, row, silent, towards

from benchmarks.scoreboard.information import (
    W_SPREAD,
    angular_gains,
    direction_gains,
    scores_of,
    student_log_density,
)
from benchmarks.scoreboard.windows import make_windows

AHEAD = np.array([0.0, 0.0, 1.0])
SPREAD = np.array([0.2, 0.3, 0.5])
UNEQUAL = np.diag([0.3, 0.02, 0.0])  # of a direction


def scores(*rows):
    return scores_of(make_windows(list(rows)))


def gain_w(estimate, truth, covariance, spread=SPREAD):
    return float(angular_gains(estimate[None], truth[None], covariance[None], spread)[0])


def gain_v(estimate, truth, covariance):
    return float(direction_gains(estimate[None], truth[None], covariance[None])[0])


def peak(dimensions, sigma):
    """Log density of Student's t at its mean, for 5 degrees of freedom and one sigma."""
    half = (5 + dimensions) / 2
    scale = math.log(5 * math.pi) + math.log(sigma**2 * 3 / 5)
    return float(gammaln(half) - gammaln(2.5)) - dimensions / 2 * scale


def test_the_density_is_that_of_another_implementation():
    rng = np.random.default_rng(0)
    for dimensions in (2, 3):
        root = rng.normal(size=(dimensions, dimensions))
        covariance, error = root @ root.T, rng.normal(size=dimensions)
        expected = multivariate_t.logpdf(error, shape=covariance * 3 / 5, df=5)
        found = student_log_density(error[None], covariance[None])[0]
        assert found == pytest.approx(expected, rel=1e-6)


def test_the_gain_of_w_is_density_over_density():
    rng = np.random.default_rng(1)
    root, estimate, truth = rng.normal(size=(3, 3)), rng.normal(size=3), rng.normal(size=3)
    after = multivariate_t.logpdf(truth, estimate, root @ root.T * 3 / 5, df=5)
    before = multivariate_normal.logpdf(truth, np.zeros(3), np.diag(SPREAD**2))
    expected = (after - before) / math.log(2)
    assert gain_w(estimate, truth, root @ root.T) == pytest.approx(expected, rel=1e-6)


def test_a_perfect_estimate_of_w_gains_what_its_covariance_says():
    sigma, truth = math.radians(2.0), np.array([0.1, -0.2, 0.3])
    before = -1.5 * math.log(2 * math.pi) - np.log(SPREAD).sum()
    before -= 0.5 * ((truth / SPREAD) ** 2).sum()
    expected = (peak(3, sigma) - before) / math.log(2)
    assert gain_w(truth, truth, sigma**2 * np.eye(3)) == pytest.approx(expected, abs=1e-6)


def test_the_unit_of_w_does_not_matter():
    estimate, truth, covariance = np.array([0.1, 0.2, 0.0]), np.array([0.2, 0.2, 0.1]), np.eye(3)
    f = math.degrees(1.0)
    other = gain_w(f * estimate, f * truth, f**2 * 0.01 * covariance, f * SPREAD)
    assert gain_w(estimate, truth, 0.01 * covariance) == pytest.approx(other, abs=1e-6)


def test_a_perfect_direction_gains_what_its_covariance_says():
    sigma = math.radians(3.0)
    covariance = sigma**2 * np.diag([1.0, 1.0, 0.0])
    beyond = (1 + 4 / (5 * sigma**2 * 3 / 5)) ** -2.5  # of the disc of radius 2
    expected = peak(2, sigma) - math.log(1 - beyond) + math.log(4 * math.pi)
    assert gain_v(AHEAD, AHEAD, covariance) == pytest.approx(expected / math.log(2), abs=1e-6)


@pytest.mark.parametrize("factor", [0.3, 1.0, 30.0])
def test_the_density_of_directions_is_one_over_the_sphere(factor):
    """The mean over the sphere of the density over that of no knowledge, 2^gain, is 1."""
    n = 10_000
    z, turn = 1 - (2 * np.arange(n) + 1) / n, np.arange(n) * math.pi * (3 - math.sqrt(5))
    truths = np.stack([np.cos(turn) * np.sqrt(1 - z**2), np.sin(turn) * np.sqrt(1 - z**2), z], 1)
    estimates, covariances = np.tile(AHEAD, (n, 1)), np.tile(factor * UNEQUAL, (n, 1, 1))
    gains = direction_gains(estimates, truths, covariances)
    assert (2**gains).mean() == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("degrees", [0.0, 60.0, 180.0])
def test_a_direction_without_any_certainty_gains_nothing(degrees):
    assert gain_v(AHEAD, towards(degrees), 1e6 * np.eye(3)) == pytest.approx(0.0, abs=1e-4)


def test_the_error_of_a_direction_counts_along_its_own_sigma():
    wide, narrow = np.diag([0.1, 1e-4, 0.0]), np.diag([1e-4, 0.1, 0.0])
    assert gain_v(AHEAD, towards(20.0), wide) > 1.0
    assert gain_v(AHEAD, towards(20.0), narrow) < -5.0


def test_confident_and_wrong_loses_and_stays_finite():
    wrong = np.radians([40.0, 0.0, 0.0])
    for sigma in (1e-3, 0.0):
        sure = sigma**2 * np.eye(3)
        w, v = gain_w(wrong, np.zeros(3), sure), gain_v(AHEAD, towards(180.0), sure)
        assert -200 < w < -10
        assert -200 < v < -10


def test_silence_gains_exactly_nothing_and_has_the_whole_way_as_error():
    found = scores(silent(), silent(moved_px=1.0, truth_px=1.0))
    assert (found.gain_w_bits, found.gain_v_bits, found.epe_share_all) == (0.0, 0.0, 100.0)
    assert (found.gain_w_windows, found.gain_v_windows, found.epe_share_windows) == (2, 2, 2)


def test_silence_in_half_of_the_windows_halves_the_gains():
    whole, half = scores(row()), scores(row(), silent())
    assert whole.gain_w_bits > 5
    assert half.gain_w_bits == pytest.approx(whole.gain_w_bits / 2)
    assert half.gain_v_bits == pytest.approx(whole.gain_v_bits / 2)
    assert (whole.epe_share_all, half.epe_share_all) == pytest.approx((5.0, 52.5))


def test_an_estimate_without_flow_or_without_direction_gains_what_it_tells():
    found = scores(row(epe_px=NAN, linear=np.full(3, NAN), linear_covariance=NAN))
    assert found.gain_w_bits == scores(row()).gain_w_bits
    assert (found.gain_v_bits, found.epe_share_all) == (0.0, 100.0)


def test_windows_count_that_move_by_a_pixel_and_whose_truth_is_known():
    nothing = np.full(3, NAN)
    for left_out in (row(moved_px=0.99), row(moved_px=NAN)):
        assert scores(row(), left_out) == scores(row())
    unknown = row(true_angular=nothing, true_linear=nothing, truth_px=NAN, epe_px=NAN)
    assert scores(row(), unknown) == scores(row())
    assert math.isnan(scores(unknown).gain_w_bits)
    assert math.isnan(scores(unknown).epe_share_all)


def test_w_is_scored_against_the_scaled_truth_and_the_written_spread():
    windows = make_windows([row(angular=np.radians([12.0, 0.0, 0.0]))])
    scaled = np.radians([12.0, 0.0, 0.0])
    expected = gain_w(scaled, scaled, windows["angular_covariance"][0], W_SPREAD)
    assert scores_of(windows, 1.2).gain_w_bits == pytest.approx(expected)
