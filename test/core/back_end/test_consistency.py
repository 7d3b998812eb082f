"""How far a motion is to be believed: what is learnt of it, and what is made of that."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.back_end.consistency import (
    Experience,
    angular_factor,
    direction_variance,
    factor_by_gyro,
    variance_by_gyro,
)
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import MotionAt
from emoflow_ros.core.types.gyro import KnownBias, SeenBias

LAW = BackEndSettings().errors
W, V = np.array([0.1, -0.2, 0.3]), np.array([0.0, 0.0, 2.0])
SD = 0.02  # rad/s
NO_DIRECTION = np.zeros(3)


def told(angular: np.ndarray = W, linear: np.ndarray = V) -> MotionAt:
    return MotionAt(angular, linear, SD**2 * np.eye(3))


def turned(angle: float) -> np.ndarray:
    return 3 * np.array([np.sin(angle), 0.0, np.cos(angle)])


def first(angular: np.ndarray = W, direction: np.ndarray = V) -> Experience:
    """After a first window with what the lattice measures."""
    return Experience.none(LAW).after(5, told(), None, (angular, direction), LAW)


def test_the_first_window_sets_the_distance_to_the_lattice():
    seen = first(direction=turned(0.4))
    assert seen.astray == pytest.approx(0.4)
    assert seen.revised == pytest.approx(np.log(LAW.usual_revision))
    assert seen.turned == pytest.approx(np.log(LAW.usual_turn))
    assert first(direction=NO_DIRECTION).astray == LAW.unknown_angle
    still = Experience.none(LAW).after(5, told(linear=NO_DIRECTION), None, (W, V), LAW)
    assert still.astray == LAW.unknown_angle
    assert first(direction=-V).astray == pytest.approx(np.pi)


def test_what_the_next_adjustment_revises_is_learnt_by_a_share():
    before, share = first(), LAW.share
    again = told(W + np.array([0.0, 3 * SD, 0.0]), turned(0.1))
    after = before.after(9, told(), again, (W, V), LAW)
    revised = (1 - share) * before.revised + share * np.log(LAW.least + 9 / 3)
    assert after.revised == pytest.approx(revised)
    turn = (1 - share) * before.turned + share * np.log(LAW.least + 0.1)
    assert after.turned == pytest.approx(turn)
    assert after.t == 9


def test_where_the_adjustment_does_not_reach_back_only_distances_are_learnt():
    before = first()
    after = before.after(9, told(), None, (W + np.array([0.1, 0.0, 0.0]), turned(0.2)), LAW)
    assert (after.revised, after.turned) == (before.revised, before.turned)
    assert after.astray == pytest.approx(LAW.share * 0.2)
    np.testing.assert_allclose(after.away, [0.1, 0.0, 0.0])


def test_the_error_of_w_goes_with_revisions_lost_patches_and_length():
    seen = first()
    usual = angular_factor(seen, 0.8, 0.1, LAW)
    assert usual == pytest.approx(130 * 0.1 * (0.07 / 0.8) ** 2)
    revised = replace(seen, revised=seen.revised + np.log(2))
    assert angular_factor(revised, 0.8, 0.1, LAW) / usual == pytest.approx(4)
    assert angular_factor(seen, 0.4, 0.1, LAW) / usual == pytest.approx(4)
    assert angular_factor(seen, 0.8, 0.2, LAW) / usual == pytest.approx(2)
    assert np.isfinite(angular_factor(seen, 0.0, 0.1, LAW))  # no patch is found


def test_the_error_of_the_direction_goes_with_revisions_and_the_lattice_s_direction():
    seen = first()
    usual = direction_variance(seen, 0.8, 1.0, LAW)
    assert usual == pytest.approx(0.37 * LAW.usual_turn**2 / 0.8)
    turning = replace(seen, turned=seen.turned + np.log(2))
    assert direction_variance(turning, 0.8, 1.0, LAW) / usual == pytest.approx(4)
    astray = first(direction=turned(0.5))
    assert direction_variance(astray, 0.8, 1.0, LAW) / usual == pytest.approx(np.exp(1.0))
    assert direction_variance(seen, 0.4, 1.0, LAW) / usual == pytest.approx(2)
    assert direction_variance(seen, 0.8, 2.0, LAW) / usual == pytest.approx(4)
    # so few errors are not believed
    assert direction_variance(seen, 0.8, 0.1, LAW) == direction_variance(seen, 0.8, 0.2, LAW)


def test_the_error_of_a_gyro_s_w_turns_the_direction_the_more_the_slower_the_camera_is():
    covariance = np.diag([1.0, 2.0, 3.0]) * SD**2
    fast = variance_by_gyro(covariance, 0.4, LAW)
    assert fast == pytest.approx(0.5 * 2 * SD**2 / 0.4**2)
    assert variance_by_gyro(covariance, 0.2, LAW) == pytest.approx(4 * fast)
    assert np.isfinite(variance_by_gyro(covariance, 0.0, LAW))


def test_the_error_of_a_gyro_s_w_goes_with_what_places_show_of_its_bias():
    """Each window's share is the log of the square over the variance of both, per axis."""
    assert factor_by_gyro(first(), LAW) == 1
    known = KnownBias(np.array([5.0, 0.0, 0.0]), 3 * SD**2 * np.eye(3))
    seen = SeenBias(np.array([0.0, 6 * SD, 0.0]), SD**2 * np.eye(3), 0.5)
    once = first().after(9, told(), None, (W, V), LAW, (seen, known))
    excess = LAW.least + 6**2 / (3 + 1) / 3
    assert factor_by_gyro(once, LAW) == pytest.approx((excess / 0.27) ** LAW.share)
    twice = once.after(11, told(), None, (W, V), LAW, (seen, known))
    share = 1 - (1 - LAW.share) ** 2
    assert factor_by_gyro(twice, LAW) == pytest.approx((excess / 0.27) ** share)
    without = twice.after(13, told(), None, (W, V), LAW)
    assert without.biased == twice.biased
    right = replace(seen, excess=np.zeros(3))
    assert factor_by_gyro(once.after(11, told(), None, (W, V), LAW, (right, known)), LAW) < 1
    surely = replace(once, biased=-9.0)
    assert factor_by_gyro(surely, LAW) == 0.3  # places may tell little
