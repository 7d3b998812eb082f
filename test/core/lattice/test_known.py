import numpy as np

from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.known import KnownRotation

S = 1_000_000_000


def test_a_gyro_draws_the_motion_to_its_mean_and_its_slope():
    """Minus the gradient and the second derivatives of both distances' squares, halved."""
    rng = np.random.default_rng(3)
    covariances = np.stack([factor @ factor.T for factor in 0.05 * rng.normal(size=(3, 3, 3))])
    measurement = GyroMeasurement(0, S // 10, rng.normal(size=(3, 3)), covariances)
    known = KnownRotation.measured(measurement, 0.1)
    mean, half_of_change = np.array([0.5, 0.5]), np.array([-0.5, 0.5])
    of_w = np.r_[0:3, 6:9]

    def cost(unknowns: np.ndarray) -> float:
        w = unknowns.reshape(2, 3) / 0.1
        apart = [mean @ w - measurement.coefficients[0]]
        apart.append(half_of_change @ w - measurement.coefficients[1])
        spread = covariances[0], covariances[1] + 1e-6 * np.eye(3)
        pairs = zip(apart, spread, strict=True)
        return 5.0 * sum(d @ np.linalg.solve(c, d) for d, c in pairs)  # INFORMATION_EXCESS / 2

    w = 0.1 * rng.normal(size=(2, 3))
    corner, vector = np.zeros((13, 13)), np.zeros(13)
    known.add_to(w, corner, vector)
    step = 1e-3
    ahead, behind = (
        np.array([cost(w.ravel() + sign * step * axis) for axis in np.eye(6)]) for sign in (1, -1)
    )
    np.testing.assert_allclose(vector[of_w], (behind - ahead) / (2 * step), rtol=2e-3)
    second = (ahead + behind - 2 * cost(w.ravel())) / step**2
    np.testing.assert_allclose(np.diag(corner)[of_w], second, rtol=2e-3)
    others = np.setdiff1d(np.arange(13), of_w)
    assert not corner[others].any() and not vector[others].any()
    # One step of Newton's method gives both.
    found = w + (np.linalg.pinv(corner) @ vector)[of_w].reshape(2, 3)
    np.testing.assert_allclose(mean @ found / 0.1, measurement.coefficients[0], rtol=1e-4)
    slope = half_of_change @ found / 0.1
    np.testing.assert_allclose(slope, measurement.coefficients[1], rtol=1e-3)


def test_a_gyro_s_ends_are_those_of_its_line():
    coefficients = np.array([[0.3, -0.1, 0.2], [0.5, 1.0, -2.0], [0.0, 0.0, 0.0]])
    measurement = GyroMeasurement(0, S // 10, coefficients, np.tile(1e-4 * np.eye(3), (3, 1, 1)))
    ends = KnownRotation.measured(measurement, 0.1).ends()
    for s, w in zip((0.0, 1.0), ends, strict=True):
        np.testing.assert_allclose(w / 0.1, measurement.at(s), atol=1e-12)
