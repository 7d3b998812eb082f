import numpy as np
import pytest
from motion_fields import (
    INLIER_PX,
    LATTICE,
    NODES,
    camera_with,
    motion_field,
    random_motions,
    structure_residuals,
)

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import MOTION_UNKNOWNS, Motion, NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice


def test_motion_field_in_pixels_is_that_of_moving_points(lens, epipolar):
    """Points before the moving camera, projected through its lens, by finite differences."""
    camera = camera_with(lens)
    bearings, _ = camera.undistort(LATTICE.pixels)
    for v, w, inverse_depth in list(random_motions(1))[:10]:
        points = np.column_stack([bearings, np.ones(NODES)]) / inverse_depth[:, None]
        step = 1e-5 * (-v - np.cross(w, points))
        moved = (camera.project(points + step) - camera.project(points - step)) / 2e-5
        expected = motion_field(epipolar, v, w, inverse_depth)
        np.testing.assert_allclose(moved, expected, atol=1e-5)


def test_residuals_vanish_on_the_motion_field(epipolar):
    """Motions that change within the window, too."""
    rng = np.random.default_rng(2)
    for v, w, inverse_depth in random_motions(2):
        motion = Motion(w + rng.normal(scale=0.01, size=(2, 3)), v + 0.3 * rng.normal(size=(2, 3)))
        fields = [
            motion_field(epipolar, v_t, w_t, inverse_depth)
            for v_t, w_t in zip(motion.v, motion.w, strict=True)
        ]
        assert np.abs(epipolar.residuals(np.stack(fields, 1), motion).r).max() < 1e-10


def test_residual_is_the_distance_to_the_epipolar_line(epipolar):
    """Moving the flow along the line changes nothing, moving it across counts in full."""
    v, w = np.array([1.0, 0.0, 0.0]), np.array([0.01, 0.02, -0.01])
    flow = motion_field(epipolar, v, w, np.full(NODES, 0.05))
    line = epipolar.a @ v
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    across = np.stack([-line[:, 1], line[:, 0]], -1)
    moved = np.repeat((flow + 3 * line + 0.5 * across)[:, None], LATTICE.times, 1)
    r = epipolar.residuals(moved, Motion.constant(w, v)).r
    np.testing.assert_allclose(r, 0.5, rtol=1e-5)


@pytest.mark.parametrize("kind", ["across", "along"])
def test_derivatives_of_the_residuals(epipolar, kind):
    rng = np.random.default_rng(30)
    v, w, inverse_depth = next(random_motions(3))
    motion = Motion(w + rng.normal(scale=0.01, size=(2, 3)), v + 0.2 * rng.normal(size=(2, 3)), 1.3)
    flow = motion_field(epipolar, v, w, inverse_depth)[:, None] + rng.normal(
        size=(NODES, LATTICE.times, 2)
    )

    def residuals(flow, motion):
        if kind == "across":
            return epipolar.residuals(flow, motion)
        return structure_residuals(epipolar, flow, motion, inverse_depth)

    linearised = residuals(flow, motion)
    h = 1e-6
    for step in h * np.eye(2):
        slope = (residuals(flow + step, motion).r - residuals(flow - step, motion).r) / (2 * h)
        np.testing.assert_allclose(linearised.by_flow @ step / h, slope, atol=1e-7)
    for step in h * np.eye(MOTION_UNKNOWNS):
        ahead, behind = (
            residuals(flow, Motion(motion.w + sign * step[:-1].reshape(2, 6)[:, :3],
                                   motion.v + sign * step[:-1].reshape(2, 6)[:, 3:],
                                   motion.speed + sign * step[-1])).r
            for sign in (1, -1)
        )  # fmt: skip
        unit = step / h
        slope = np.stack(
            [linearised.by_motion[:, q] @ np.append(unit[6 * q : 6 * q + 6], unit[12])
             for q in (0, 1)], axis=1,
        )  # fmt: skip
        size = 1 + np.abs(slope).max()
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * h), atol=1e-6 * size)


def test_structure_residuals_vanish_for_the_true_depth_and_speed(epipolar):
    for v, w, inverse_depth in random_motions(11):
        flow = motion_field(epipolar, v, w, inverse_depth)
        motion = Motion.constant(w, v)
        motion = Motion(motion.w, motion.v, 1.6)
        moved = np.repeat(flow[:, None], LATTICE.times, 1)
        r = structure_residuals(epipolar, moved, motion, inverse_depth / 1.6).r
        # Near the focus of expansion the line's norm is softened: by at most `soft`.
        assert np.abs(r).max() < epipolar.soft * inverse_depth.max()
        assert np.median(np.abs(r)) < 1e-4


def test_rotational_flow(epipolar):
    w = np.random.default_rng(4).normal(size=(2, 3))
    flow = epipolar.rotational_flow(Motion(w, np.ones((2, 3))))
    for q in range(LATTICE.times):
        np.testing.assert_allclose(flow[:, q], epipolar.b @ w[q])


def test_robust_weights_fall_from_one_to_a_quarter_and_on(epipolar):
    r = np.tile([0.0, INLIER_PX, -3 * INLIER_PX], (NODES, 1))
    np.testing.assert_allclose(epipolar.robust_weight(r), np.tile([1, 0.25, 0.01], (NODES, 1)))


def test_nodes_beyond_the_lens_are_left_out():
    """A fisheye whose image circle has a radius of 157 px on a sensor of 400 x 400."""
    camera = Camera(400, 400, 100.0, 100.0, 199.5, 199.5, "equidistant", (0.0,) * 4)
    lattice = Lattice(400, 400, 9, 9)
    epipolar = NodeEpipolar(camera, lattice, INLIER_PX)
    radius = np.linalg.norm(lattice.pixels - 199.5, axis=1)
    np.testing.assert_array_equal(epipolar.usable, radius < 157)
    v, w = np.array([0.6, 0.0, 0.8]), np.array([0.01, -0.02, 0.03])
    flow = 0.05 * (epipolar.a @ v) + epipolar.b @ w
    flow[~epipolar.usable] = 1e3
    found = epipolar.score(v, flow, np.tile(1e4 * np.eye(2), (81, 1, 1)))
    np.testing.assert_allclose(found.w[0], w, atol=1e-6)
    residuals = epipolar.residuals(np.repeat(flow[:, None], 2, 1), Motion.constant(w, v))
    assert np.isfinite(residuals.r).all() and np.isfinite(residuals.by_motion).all()
    weights = epipolar.robust_weight(residuals.r)
    np.testing.assert_array_equal(weights[~epipolar.usable], 0)


def test_motion_moves_by_its_ends_and_keeps_the_scale_of_v():
    w, v = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.6, 0.8])
    motion = Motion.constant(w, v)
    np.testing.assert_allclose(motion.at(0.3), [w, v])
    step = np.append(np.hstack([[[0.5] * 3, [0.0] * 3], 2 * motion.v]), 0.25)
    moved = motion.moved(step)
    np.testing.assert_allclose(moved.at(0.8), [w + [0.1] * 3, v])
    np.testing.assert_array_equal(motion.moved(motion.unknowns).w, 2 * motion.w)
    assert (motion.speed, moved.speed) == (1.0, 1.25)
    assert np.linalg.norm(moved.v.mean(axis=0)) == pytest.approx(1)
