import numpy as np

from emoflow_ros.core.geometry.camera_motion import basis
from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.known import KnownRotation

S = 1_000_000_000


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
