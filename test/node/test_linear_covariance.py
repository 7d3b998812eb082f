"""What a filter makes of a twist: it must learn nothing where nothing is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from emoflow_ros.node.linear_covariance import REP_145, UNKNOWN, WIDE, published_covariance

DIRECTION = np.array([0.0, 0.6, 0.8])
ACROSS = 0.02**2 * (np.eye(3) - np.outer(DIRECTION, DIRECTION))
ANGULAR = np.diag([0.01, 0.02, 0.03])
KNOWN = np.block([[ACROSS, np.full((3, 3), 1e-5)], [np.full((3, 3), 1e-5), ANGULAR]])
UNOBSERVABLE = np.block([[np.diag([-1.0, 0, 0]), np.zeros((3, 3))], [np.zeros((3, 3)), ANGULAR]])
# What the filter believed before, in m/s and rad/s.
BELIEF, SPREAD = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]), 0.1**2 * np.eye(6)


def fused(
    linear: NDArray[np.float64], covariance: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The velocity and its variances after a Kalman step, as robot_localization makes it.

    It takes the absolute value of negative variances, and raises those near zero.
    """
    noise = covariance.copy()
    variances = np.maximum(np.abs(noise.diagonal()), 1e-9)
    np.fill_diagonal(noise, variances)
    gain = SPREAD @ np.linalg.inv(SPREAD + noise)
    belief = BELIEF + gain @ (np.concatenate([linear, np.zeros(3)]) - BELIEF)
    return belief, ((np.eye(6) - gain) @ SPREAD).diagonal()


def test_travel_that_is_not_observable_teaches_a_filter_nothing() -> None:
    covariance = published_covariance(UNOBSERVABLE, np.zeros(3), None, WIDE)
    belief, variances = fused(np.zeros(3), covariance)
    np.testing.assert_allclose(belief[:3], BELIEF[:3], atol=1e-6)
    np.testing.assert_allclose(variances[:3], 0.01, rtol=1e-6)
    assert (variances[3:] < 0.008).all()  # the angular velocity does
    belief, _ = fused(np.zeros(3), published_covariance(UNOBSERVABLE, np.zeros(3), None, REP_145))
    assert (np.abs(belief[1:3]) < 1e-6).all()  # "vy = vz = 0, certain"


def test_unit_length_teaches_a_filter_no_speed() -> None:
    covariance = published_covariance(KNOWN, DIRECTION, None, WIDE)
    belief, _ = fused(DIRECTION, covariance)
    assert belief[:3] @ DIRECTION == pytest.approx(BELIEF[:3] @ DIRECTION, abs=1e-3)
    assert np.linalg.norm(np.cross(belief[:3], DIRECTION)) < 0.2  # the direction does
    assert np.linalg.norm(np.cross(BELIEF[:3], DIRECTION)) > 0.9
    assert np.linalg.eigvalsh(covariance).min() > 1e-5


def test_speed_that_is_given_is_exact() -> None:
    for form in (WIDE, REP_145):
        covariance = published_covariance(KNOWN, DIRECTION, 3.0, form)
        np.testing.assert_allclose(covariance[:3, :3], 9 * ACROSS)
        np.testing.assert_allclose(covariance[:3, 3:], 3e-5)
        np.testing.assert_array_equal(covariance[3:, 3:], ANGULAR)


def test_at_rest_a_filter_learns_that_the_velocity_is_zero_whatever_the_scale() -> None:
    at_rest = np.diag([1e-4] * 3 + [1e-6] * 3)
    for speed in (None, 0.0, 5.0):
        covariance = published_covariance(at_rest, np.zeros(3), speed, WIDE)
        np.testing.assert_array_equal(covariance, at_rest)
        belief, variances = fused(np.zeros(3), covariance)
        assert (np.abs(belief[:3]) < 0.05).all() and (variances[:3] < 2e-4).all()


def test_speed_says_nothing_where_there_is_no_direction() -> None:
    covariance = published_covariance(UNOBSERVABLE, np.zeros(3), 3.0, WIDE)
    np.testing.assert_array_equal(covariance[:3, :3], UNKNOWN * np.eye(3))
    np.testing.assert_array_equal(covariance[:3, 3:], 0)


def test_the_mark_of_minus_one_is_kept_where_it_is_wanted() -> None:
    for covariance in (KNOWN, UNOBSERVABLE):
        found = published_covariance(covariance, DIRECTION, None, REP_145)
        np.testing.assert_array_equal(found, covariance)
