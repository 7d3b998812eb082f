from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.camera_motion import SplineMotion
from emoflow_ros.core.estimate import (
    Estimate,
    MotionModel,
    Quality,
    Status,
    Twist,
    at_middle,
    covariance_at_speed,
    covariance_in_frame,
    grid_times,
    sample,
)

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


def test_grid_is_uniform_over_windows_that_join() -> None:
    edges = [START + i * 90 * MS for i in range(6)]
    times: list[int] = []
    for t_start, t_end in pairwise(edges):
        times += grid_times(t_start, t_end, 200.0, after=times[-1] if times else 0)
    assert set(np.diff(times)) == {5 * MS}
    assert edges[0] <= times[0] < edges[0] + 5 * MS
    assert edges[-1] - 5 * MS <= times[-1] < edges[-1]


def test_overlapping_windows_give_each_time_once() -> None:
    first = grid_times(0, 90 * MS, 100.0, after=-1)
    assert first == [10 * MS * k for k in range(9)]
    assert grid_times(30 * MS, 120 * MS, 100.0, first[-1]) == [90 * MS, 100 * MS, 110 * MS]


def test_times_of_one_window_are_bounded() -> None:
    times = grid_times(0, 3600 * 1000 * MS, 1000.0, after=-1)
    assert len(times) == 10_000
    assert times[-1] == 3_599_999 * MS


def test_samples_follow_the_spline() -> None:
    twists = sample(estimate(MotionModel.FULL), [0, 25 * MS, 50 * MS])
    assert [t.t for t in twists] == [0, 25 * MS, 50 * MS]
    np.testing.assert_allclose([t.angular[2] for t in twists], [1.0, 1.25, 1.5])
    np.testing.assert_allclose(twists[0].linear, [0.0, 0.6, 0.8])
    middle = at_middle(estimate(MotionModel.FULL))
    assert middle.t == 50 * MS
    np.testing.assert_allclose(middle.angular, twists[2].angular)


def test_samples_have_no_direction_where_it_is_not_observable() -> None:
    [twist] = sample(estimate(MotionModel.ROTATION), [10 * MS])
    np.testing.assert_array_equal(twist.linear, np.zeros(3))


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
