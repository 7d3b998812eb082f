import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from emoflow_ros.core.geometry.camera_motion import CONTROL_POINTS, SplineMotion, basis

MS = 1_000_000
START = 1_500_000_000_000_000_000


def test_known_values():
    np.testing.assert_allclose(basis(0.0), np.array([1, 4, 1, 0]) / 6)
    np.testing.assert_allclose(basis(0.5), np.array([1, 23, 23, 1]) / 48)
    np.testing.assert_allclose(basis(1.0), np.array([0, 1, 4, 1]) / 6, atol=1e-15)


@given(st.floats(0, 1))
def test_weights_sum_to_one_and_are_not_negative(s):
    weights = basis(s)
    assert weights.sum() == pytest.approx(1, abs=1e-14)
    assert (weights >= -1e-16).all()
    np.testing.assert_allclose(weights[::-1], basis(1 - s), atol=1e-14)


def test_it_is_the_uniform_cubic_b_spline():
    s = np.linspace(0, 0.999, 50)
    knots = np.arange(-3.0, 5.0)
    expected = BSpline.design_matrix(s, knots, 3).toarray()
    np.testing.assert_allclose(basis(s), expected, atol=1e-12)


def test_segments_join_with_two_derivatives():
    """The end of one segment is the start of the next, whose control points are one further."""
    points = np.random.default_rng(1).normal(size=CONTROL_POINTS + 1)
    h = 1e-3
    end = basis(1 + h * np.arange(-2, 3)) @ points[:-1]  # beyond 1: the same polynomial
    start = basis(h * np.arange(-2, 3)) @ points[1:]
    for derivative in ([0, 0, 1, 0, 0], [1, -8, 0, 8, -1], [-1, 16, -30, 16, -1]):
        np.testing.assert_allclose(derivative @ end, derivative @ start, atol=1e-7)


def test_shape_of_the_basis_follows_the_argument():
    assert basis(np.zeros((5, 7))).shape == (5, 7, CONTROL_POINTS)


def test_constant_motion_is_constant():
    w, v = np.array([0.1, -0.2, 0.3]), np.array([0.0, 3.0, 4.0])
    motion = SplineMotion(START, START + 90 * MS, np.tile(w, (4, 1)), np.tile(v, (4, 1)))
    for t in (START, START + 37 * MS, START + 90 * MS):
        np.testing.assert_allclose(motion.angular(t), w)
        np.testing.assert_allclose(motion.linear(t), [0, 0.6, 0.8])


def test_control_points_on_a_line_move_linearly():
    """A uniform B-spline reproduces a line: at s it is where the middle points are."""
    slope = np.array([0.5, -1.0, 2.0])
    points = np.outer(np.arange(-1.0, 3.0), slope)  # 0 at s = 0, the slope at s = 1
    motion = SplineMotion(START, START + 80 * MS, points, np.zeros((4, 3)))
    np.testing.assert_allclose(motion.angular(START), np.zeros(3), atol=1e-15)
    np.testing.assert_allclose(motion.angular(START + 20 * MS), 0.25 * slope)
    np.testing.assert_allclose(motion.angular(START + 80 * MS), slope)


def test_linear_is_a_unit_vector_or_zero():
    points = np.random.default_rng(2).normal(size=(4, 3))
    motion = SplineMotion(START, START + 90 * MS, points, points)
    for t in range(START, START + 91 * MS, 10 * MS):
        assert np.linalg.norm(motion.linear(t)) == pytest.approx(1)
        np.testing.assert_allclose(np.cross(motion.linear(t), motion.angular(t)), 0, atol=1e-12)
    unobservable = SplineMotion(START, START + 90 * MS, points, np.zeros((4, 3)))
    np.testing.assert_array_equal(unobservable.linear(START), np.zeros(3))
