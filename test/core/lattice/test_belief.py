import numpy as np
import pytest

from emoflow_ros.core.geometry.camera_motion import basis
from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.belief import INFORMATION_EXCESS, Belief, KnownRotation

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


def test_a_gyro_draws_the_spline_to_its_mean_and_its_slope():
    """Minus the gradient and the second derivatives of both distances' squares, halved."""
    rng = np.random.default_rng(3)
    covariances = np.stack([factor @ factor.T for factor in 0.05 * rng.normal(size=(3, 3, 3))])
    measurement = GyroMeasurement(0, S // 10, rng.normal(size=(3, 3)), covariances)
    known = KnownRotation.measured(measurement, 0.1)
    s = (np.arange(10_000) + 0.5) / 10_000
    mean = basis(s).mean(axis=0)
    half_of_change = 3 * ((2 * s - 1)[:, None] * basis(s)).mean(axis=0)  # that of the best line

    def cost(unknowns: np.ndarray) -> float:
        w = unknowns.reshape(4, 3) / 0.1
        apart = [mean @ w - measurement.coefficients[0]]
        apart.append(half_of_change @ w - measurement.coefficients[1])
        spread = covariances[0], covariances[1] + 1e-6 * np.eye(3)
        pairs = zip(apart, spread, strict=True)
        return 5.0 * sum(d @ np.linalg.solve(c, d) for d, c in pairs)  # INFORMATION_EXCESS / 2

    w = 0.1 * rng.normal(size=(4, 3))
    corner, vector = np.zeros((14, 14)), np.zeros(14)
    known.add_to(w, corner, vector)
    step = 1e-3
    ahead, behind = (
        np.array([cost(w.ravel() + sign * step * axis) for axis in np.eye(12)]) for sign in (1, -1)
    )
    np.testing.assert_allclose(vector[:12], (behind - ahead) / (2 * step), rtol=2e-3)
    second = (ahead + behind - 2 * cost(w.ravel())) / step**2
    np.testing.assert_allclose(np.diag(corner)[:12], second, rtol=2e-3)
    assert not corner[12:].any() and not vector[12:].any()
    # One step of Newton's method gives both, the least change of w that does.
    found = w + (np.linalg.pinv(corner) @ vector)[:12].reshape(4, 3)
    np.testing.assert_allclose(mean @ found / 0.1, measurement.coefficients[0], rtol=1e-4)
    slope = half_of_change @ found / 0.1
    np.testing.assert_allclose(slope, measurement.coefficients[1], rtol=1e-3)


def test_a_gyro_s_spline_has_its_mean_and_its_slope():
    coefficients = np.array([[0.3, -0.1, 0.2], [0.5, 1.0, -2.0], [0.0, 0.0, 0.0]])
    measurement = GyroMeasurement(0, S // 10, coefficients, np.tile(1e-4 * np.eye(3), (3, 1, 1)))
    points = KnownRotation.measured(measurement, 0.1).control_points()
    for s in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(basis(s) @ points / 0.1, measurement.at(s), atol=1e-12)
