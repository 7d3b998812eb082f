import numpy as np
import pytest

from emoflow_ros.simulation.recording import SCENES, build_scene
from emoflow_ros.simulation.scene import PITCH, ROLL, YAW, Step, Trajectory, Wave, X, Z

STEP = 1e-5


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("t", [0.0, 0.37, 2.9])
def test_twist_is_the_derivative_of_the_pose(name: str, t: float) -> None:
    path = build_scene(name, 3.0, np.random.default_rng(1)).camera
    rotation, _ = path.pose(t)
    (r0, p0), (r1, p1) = path.pose(t - STEP), path.pose(t + STEP)
    linear, angular = path.twist(t)
    np.testing.assert_allclose(linear, rotation.T @ (p1 - p0) / (2 * STEP), atol=1e-7)
    skew = rotation.T @ (r1 - r0) / (2 * STEP)
    np.testing.assert_allclose(angular, (skew[2, 1], skew[0, 2], skew[1, 0]), atol=1e-7)


def test_rates_at_large_angles_against_finite_differences() -> None:
    path = Trajectory(
        offset=(0, 0, 0, 1.0, 0.8, -2.0),
        rate=(1.0, 0, 0, 0.5, -0.2, 0.3),
        waves=(Wave(YAW, 0.7, 1.0, 0.1), Wave(PITCH, 0.4, 0.6, 1.0), Wave(ROLL, 1.0, 0.5, 2.0)),
    )
    rotation, _ = path.pose(0.4)
    skew = rotation.T @ (path.pose(0.4 + STEP)[0] - path.pose(0.4 - STEP)[0]) / (2 * STEP)
    _, angular = path.twist(0.4)
    np.testing.assert_allclose(angular, (skew[2, 1], skew[0, 2], skew[1, 0]), atol=1e-7)


def test_acceleration_of_one_wave_in_closed_form() -> None:
    path = Trajectory(rate=(0, 0, 2.0, 0, 0, 0), waves=(Wave(X, 0.5, 2.0, 0.0),))
    omega = 4 * np.pi
    expected = -0.5 * omega**2 * np.sin(omega * 0.1)
    np.testing.assert_allclose(path.acceleration(0.1), (expected, 0, 0))
    np.testing.assert_allclose(path.pose(0.1)[1][Z], 0.2)


def test_yaw_looks_right_and_pitch_looks_up() -> None:
    right = Trajectory(offset=(0, 0, 0, 0.1, 0, 0)).pose(0)[0] @ (0, 0, 1)
    up = Trajectory(offset=(0, 0, 0, 0, 0.1, 0)).pose(0)[0] @ (0, 0, 1)
    np.testing.assert_allclose(right, (np.sin(0.1), 0, np.cos(0.1)))
    np.testing.assert_allclose(up, (0, -np.sin(0.1), np.cos(0.1)))


def swinging() -> Trajectory:
    return Trajectory(
        offset=(0.1, 0.2, 0.3, 0.5, -0.4, 0.8),
        waves=(Wave(YAW, 0.4, 1.0, 0.1), Wave(PITCH, 0.3, 0.6, 1.0), Wave(ROLL, 0.5, 0.5, 2.0)),
        steps=(Step(X, 0.7, 0.2, 0.5), Step(YAW, 0.6, 0.3, 0.4)),
        lever=(0.1, -0.05, 0.2),
    )


@pytest.mark.parametrize("t", [0.1, 0.35, 0.6, 0.9])
def test_steps_and_a_lever_have_exact_derivatives(t: float) -> None:
    path = swinging()
    rotation, _ = path.pose(t)
    (r0, p0), (r1, p1) = path.pose(t - STEP), path.pose(t + STEP)
    linear, angular = path.twist(t)
    np.testing.assert_allclose(linear, rotation.T @ (p1 - p0) / (2 * STEP), atol=1e-7)
    skew = rotation.T @ (r1 - r0) / (2 * STEP)
    np.testing.assert_allclose(angular, (skew[2, 1], skew[0, 2], skew[1, 0]), atol=1e-7)

    def velocity(at: float) -> np.ndarray:
        return path.pose(at)[0] @ path.twist(at)[0]

    difference = (velocity(t + STEP) - velocity(t - STEP)) / (2 * STEP)
    np.testing.assert_allclose(path.acceleration(t), difference, atol=1e-5)
    difference = (path.twist(t + STEP)[1] - path.twist(t - STEP)[1]) / (2 * STEP)
    np.testing.assert_allclose(path.angular_acceleration(t), difference, atol=1e-5)


def test_a_step_goes_from_rest_to_rest() -> None:
    path = Trajectory(steps=(Step(X, 2.0, 1.0, 0.5),))
    for t, x in ((0.0, 0.0), (1.0, 0.0), (1.25, 1.0), (1.5, 2.0), (3.0, 2.0)):
        np.testing.assert_allclose(path.pose(t)[1][X], x, atol=1e-12)
    for t in (0.9, 1.0, 1.5, 1.6):  # velocity and acceleration are continuous
        np.testing.assert_allclose(path.twist(t)[0], 0, atol=1e-12)
        np.testing.assert_allclose(path.acceleration(t), 0, atol=1e-12)
    np.testing.assert_allclose(path.twist(1.25)[0], (1.875 * 2.0 / 0.5, 0, 0))
