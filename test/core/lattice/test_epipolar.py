import numpy as np
import pytest

from emoflow_ros.core.geometry.camera_motion import cheirality, dec_residual, motion_matrices

MOTIONS = 300
POINTS = 200


def skew(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def random_scene(rng):
    """A static scene before a moving camera: bearings, depths, v (unit), w, flow in 1/s."""
    bearings = rng.uniform((-0.77, -0.58), (0.77, 0.58), (POINTS, 2))
    depth = np.exp(rng.uniform(np.log(0.5), np.log(30), POINTS))
    v = rng.normal(size=3)
    v /= np.linalg.norm(v)
    w = rng.normal(size=3)
    a, b = motion_matrices(bearings)
    return bearings, depth, v, w, a @ v / depth[:, None] + b @ w


@pytest.fixture(scope="module")
def scenes():
    rng = np.random.default_rng(1)
    return [random_scene(rng) for _ in range(MOTIONS)]


def test_motion_matrices_by_hand():
    a, b = motion_matrices(np.array([0.5, -0.25]))
    np.testing.assert_allclose(a, [[-1, 0, 0.5], [0, -1, -0.25]])
    np.testing.assert_allclose(b, [[-0.125, -1.25, -0.25], [1.0625, 0.125, -0.5]])


def test_motion_field_is_the_derivative_of_the_projection(scenes):
    """A static point moves as dP/dt = -v - w x P in the camera's frame."""
    for bearings, depth, v, w, flow in scenes[:20]:
        points = np.column_stack([bearings, np.ones(POINTS)]) * depth[:, None]
        velocity = -v - np.cross(w, points)
        h = 1e-6
        ahead, behind = points + h * velocity, points - h * velocity
        moved = ahead[:, :2] / ahead[:, 2:] - behind[:, :2] / behind[:, 2:]
        np.testing.assert_allclose(moved / (2 * h), flow, rtol=1e-6, atol=1e-8)


def test_dec_vanishes_on_every_motion_field(scenes):
    for bearings, _, v, w, flow in scenes:
        size = np.linalg.norm(flow, axis=1)
        assert np.abs(dec_residual(bearings, flow, v, w) / size).max() < 1e-13


def test_dec_is_the_matrix_formula():
    """e = U^T [v]x X - X^T S X, S = ([v]x [w]x + [w]x [v]x) / 2, for any flow."""
    rng = np.random.default_rng(2)
    for _ in range(MOTIONS):
        bearings, flow = rng.normal(size=(2, 10, 2))
        v, w = rng.normal(size=(2, 3))
        symmetric = (skew(v) @ skew(w) + skew(w) @ skew(v)) / 2
        expected = [
            np.append(u, 0) @ skew(v) @ np.append(x, 1)
            - np.append(x, 1) @ symmetric @ np.append(x, 1)
            for x, u in zip(bearings, flow, strict=True)
        ]
        np.testing.assert_allclose(dec_residual(bearings, flow, v, w), expected, atol=1e-12)


def test_dec_changes_its_sign_and_scale_with_v():
    rng = np.random.default_rng(3)
    bearings, flow = rng.normal(size=(2, 10, 2))
    v, w = rng.normal(size=(2, 3))
    e = dec_residual(bearings, flow, v, w)
    np.testing.assert_allclose(dec_residual(bearings, flow, -2 * v, w), -2 * e)


def test_motion_may_differ_from_point_to_point(scenes):
    bearings, depth, v, w, _ = scenes[0]
    a, b = motion_matrices(bearings)
    vs = v + np.linspace(-0.3, 0.3, POINTS)[:, None]
    ws = w + np.linspace(0.2, -0.2, POINTS)[:, None]
    flow = (a @ vs[..., None])[..., 0] / depth[:, None] + (b @ ws[..., None])[..., 0]
    assert np.abs(dec_residual(bearings, flow, vs, ws)).max() < 1e-13
    assert cheirality(bearings, flow, vs, ws, np.ones(POINTS)) == pytest.approx(1)
    assert np.abs(dec_residual(bearings, flow, v, w)).max() > 1e-3


def test_exact_fields_agree_wholly_with_their_motion(scenes):
    for bearings, _, v, w, flow in scenes:
        weights = np.linspace(0, 2, POINTS)
        assert cheirality(bearings, flow, v, w, weights) == pytest.approx(1)
        assert cheirality(bearings, flow, -v, w, weights) == pytest.approx(-1)


def test_cheirality_finds_the_sign_in_noise(scenes):
    """Noise as large as half of the translational flow, and w known to a tenth of it only."""
    rng = np.random.default_rng(4)
    for bearings, depth, v, w, flow in scenes:
        a, _ = motion_matrices(bearings)
        size = np.median(np.linalg.norm(a @ v / depth[:, None], axis=1))
        noisy = flow + rng.normal(scale=0.5 * size, size=flow.shape)
        guess = w + rng.normal(scale=0.1 * size, size=3)
        agreement = cheirality(bearings, noisy, v, guess, np.ones(POINTS))
        assert agreement > 0.2
        assert cheirality(bearings, noisy, -v, guess, np.ones(POINTS)) == -agreement


def test_weights_decide_between_contradicting_halves(scenes):
    bearings, depth, v, w, _ = scenes[1]
    a, b = motion_matrices(bearings)
    behind = np.where(np.arange(POINTS) < POINTS // 2, -1.0, 1.0) * depth
    flow = a @ v / behind[:, None] + b @ w
    first = (np.arange(POINTS) < POINTS // 2).astype(float)
    assert cheirality(bearings, flow, v, w, first) == pytest.approx(-1)
    assert cheirality(bearings, flow, v, w, 1 - first) == pytest.approx(1)


def test_no_evidence_decides_nothing(scenes):
    bearings, _, v, w, flow = scenes[2]
    assert cheirality(bearings, flow, v, w, np.zeros(POINTS)) == 0.0
    still = np.zeros((POINTS, 2))
    assert cheirality(bearings, still, v, np.zeros(3), np.ones(POINTS)) == 0.0
