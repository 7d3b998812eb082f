import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera_motion import SplineMotion
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.twist import Twist, at_middle, covariance_at_speed, covariance_in_frame

MS = 1_000_000
START = 1_500_000_000_123_456_789


def estimate(model: MotionModel) -> Estimate:
    """Angular velocity about z of 1 + s, s from 0 to 1 over the window."""
    angular = np.zeros((4, 3))
    angular[:, 2] = np.arange(4.0)  # a uniform B-spline reproduces straight lines
    motion = SplineMotion(0, 100 * MS, angular, np.tile([0.0, 3.0, 4.0], (4, 1)))
    return Estimate(
        t_start=0,
        t_end=100 * MS,
        t=50 * MS,
        status=Status.OK,
        quality=Quality(events=1),
        model=model,
        linear=motion.linear(50 * MS),
        angular=motion.angular(50 * MS),
        motion=motion,
    )


def test_middle_is_that_of_the_estimate() -> None:
    middle = at_middle(estimate(MotionModel.FULL))
    assert middle.t == 50 * MS
    np.testing.assert_allclose(middle.angular, [0.0, 0.0, 1.5])
    np.testing.assert_allclose(middle.linear, [0.0, 0.6, 0.8])


def test_speed_scales_the_linear_part_only() -> None:
    twist = Twist(0, np.array([0.0, 0.6, 0.8]), np.array([1.0, 2.0, 3.0])).at_speed(5.0)
    np.testing.assert_allclose(twist.linear, [0.0, 3.0, 4.0])
    np.testing.assert_array_equal(twist.angular, [1.0, 2.0, 3.0])


def test_covariance_at_a_speed_is_that_of_the_scaled_samples() -> None:
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(50, 6))
    moved = samples * [3.0, 3.0, 3.0, 1.0, 1.0, 1.0]
    np.testing.assert_allclose(covariance_at_speed(np.cov(samples.T), 3.0), np.cov(moved.T))


@pytest.mark.parametrize("speed", [0.0, 7.0])
def test_unobservable_translation_stays_marked(speed: float) -> None:
    covariance = np.diag([-1.0, 0.0, 0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(covariance_at_speed(covariance, speed), covariance)


# From the optical frame (x right, y down, z forward) to a body (x forward, y left, z up).
BODY = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def test_twist_in_a_body_frame() -> None:
    """Driving ahead and turning to the right: to the right about the axis that points down."""
    twist = Twist(7, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.5, 0.0])).in_frame(BODY)
    np.testing.assert_allclose(twist.linear, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(twist.angular, [0.0, 0.0, -0.5])
    assert twist.t == 7


def test_covariance_in_a_frame_is_that_of_the_rotated_samples() -> None:
    rng = np.random.default_rng(0)
    rotation = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix()
    samples = rng.normal(size=(50, 6)) * [1, 2, 3, 4, 5, 6]
    rotated = np.hstack([samples[:, :3] @ rotation.T, samples[:, 3:] @ rotation.T])
    found = covariance_in_frame(np.cov(samples.T), rotation)
    np.testing.assert_allclose(found, np.cov(rotated.T))


def test_unobservable_translation_stays_marked_in_another_frame() -> None:
    covariance = np.diag([-1.0, 0.0, 0.0, 0.1, 0.2, 0.3])
    found = covariance_in_frame(covariance, BODY)
    np.testing.assert_allclose(found, np.diag([-1.0, 0.0, 0.0, 0.3, 0.1, 0.2]))
