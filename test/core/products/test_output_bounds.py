"""What is held back of a motion that is wider than a user wants it."""

from collections.abc import Sequence

import numpy as np
import pytest

from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.products.output_bounds import OutputBounds
from emoflow_ros.core.types.twist import PresentTwist, Twist

V, W = np.array([0.0, 0.6, 0.8]), np.array([0.1, 0.2, 0.3])


def found(variances: Sequence[float]) -> PresentTwist:
    return PresentTwist(Twist(7, V, W), np.diag(variances))


def test_without_bounds_everything_is_given():
    wide = found([100.0] * 6)
    assert OutputBounds().apply(wide) is wide


@pytest.mark.parametrize("variances", [[1.0, 1.0, 4.1], [4.1, 0.0, 0.0]])
def test_a_motion_whose_w_is_wider_along_some_axis_is_held_back(variances):
    bounds = OutputBounds(angular=2.0)
    assert bounds.apply(found([9.0] * 3 + variances)) is None
    just = found([9.0] * 3 + [1.0, 1.0, 3.9])
    assert bounds.apply(just) is just


def test_of_a_motion_whose_direction_is_wider_the_angular_velocity_is_given():
    bounds = OutputBounds(direction=0.5)
    given = bounds.apply(found([0.0, 0.26, 0.0, 4.0, 5.0, 6.0]))
    assert given is not None
    np.testing.assert_array_equal(given.twist.linear, 0)
    np.testing.assert_array_equal(given.twist.angular, W)
    assert given.covariance[0, 0] == -1
    np.testing.assert_array_equal(given.covariance[3:, 3:], np.diag([4.0, 5.0, 6.0]))
    just = found([0.0, 0.24, 0.0, 4.0, 5.0, 6.0])
    assert bounds.apply(just) is just


def test_a_direction_that_is_not_there_is_not_too_wide():
    nothing = PresentTwist(Twist(7, np.zeros(3), W), without_translation(np.eye(6)))
    assert OutputBounds(direction=0.1).apply(nothing) is nothing
