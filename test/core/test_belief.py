import numpy as np
import pytest

from emoflow_ros.core.belief import INFORMATION_EXCESS, Belief

S = 1_000_000_000
T = 1_500_000_000 * S
W = np.array([0.1, -0.2, 0.3])
V = np.array([0.0, 0.6, 0.8])
ACROSS = np.eye(3) - np.outer(V, V)


def random_covariance(seed=1):
    factor = np.random.default_rng(seed).normal(size=(6, 6))
    return factor @ factor.T + np.eye(6)


def separate_covariance(of_w, of_v):
    """w and v know nothing of each other; v is as certain in all directions."""
    return np.diag(np.repeat([of_w, of_v], 3))


def test_covariance_of_w_and_correlations_are_kept():
    covariance = random_covariance()
    belief = Belief.of(T, W, V, covariance)
    np.testing.assert_allclose(belief.covariance[:3, :3], covariance[:3, :3])
    np.testing.assert_allclose(belief.covariance[:3, 3:], covariance[:3, 3:] @ ACROSS, atol=1e-12)
    np.testing.assert_allclose(belief.covariance, belief.covariance.T)
    assert np.linalg.eigvalsh(belief.covariance).min() > 0


def test_along_v_the_covariance_is_one_and_tied_to_nothing():
    belief = Belief.of(T, W, V, random_covariance())
    along = np.concatenate([np.zeros(3), V])
    np.testing.assert_allclose(belief.covariance @ along, along, atol=1e-12)


def test_without_drift_the_information_stays():
    """Across v; along it, where nothing is known, there remains what is worth nothing."""
    belief = Belief.of(T, W, V, separate_covariance(0.2, 0.05))
    later = belief.predicted_information(T + S, 0.0, 0.0)
    np.testing.assert_allclose(later[:3, :3], 50 * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(ACROSS @ later[3:, 3:] @ ACROSS, 200 * ACROSS, atol=1e-9)
    assert V @ later[3:, 3:] @ V == pytest.approx(INFORMATION_EXCESS)


@pytest.mark.parametrize("elapsed_s", [0.0, 0.09, 2.0])
def test_variances_grow_with_time(elapsed_s):
    belief = Belief.of(T, W, V, separate_covariance(0.2, 0.05))
    later = belief.predicted_information(T + round(elapsed_s * S), 0.5, 0.2)
    of_w = INFORMATION_EXCESS / (INFORMATION_EXCESS / 50 + 0.25 * elapsed_s)
    of_v = INFORMATION_EXCESS / (INFORMATION_EXCESS / 200 + 0.04 * elapsed_s)
    np.testing.assert_allclose(later[:3, :3], of_w * np.eye(3), atol=1e-9)
    np.testing.assert_allclose(ACROSS @ later[3:, 3:] @ ACROSS, of_v * ACROSS, atol=1e-9)


def test_time_that_goes_back_takes_nothing_away():
    belief = Belief.of(T, W, V, random_covariance())
    now, before = (belief.predicted_information(t, 0.5, 0.2) for t in (T, T - S))
    np.testing.assert_array_equal(now, before)


def test_twist_covariance_has_v_first_and_none_along_it():
    belief = Belief.of(T, W, V, random_covariance())
    covariance = belief.across()
    np.testing.assert_allclose(covariance[3:, 3:], belief.covariance[:3, :3])
    np.testing.assert_allclose(covariance[:3, 3:], belief.covariance[3:, :3])
    np.testing.assert_allclose(covariance[:3, :3] @ V, 0, atol=1e-12)
    np.testing.assert_allclose(
        covariance[:3, :3], ACROSS @ belief.covariance[3:, 3:] @ ACROSS, atol=1e-12
    )
    assert np.linalg.eigvalsh(covariance).min() > -1e-12
