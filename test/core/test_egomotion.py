import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.camera_motion import basis
from emoflow_ros.core.egomotion import MOTION_UNKNOWNS, Motion, NodeEpipolar
from emoflow_ros.core.lattice import Lattice

LENSES = {
    "none": (),
    "plumb_bob": (-0.34, 0.14, 0.0004, -0.0003),
    "equidistant": (-0.048, 0.0113, -0.0554, 0.0215),
}
LATTICE = Lattice.with_spacing(346, 260, 26.0)
NODES = LATTICE.columns * LATTICE.rows
INLIER_PX = 0.7
MOTIONS = 100  # for each lens
CERTAIN = np.tile(np.eye(2), (NODES, 1, 1))
EXACT = 1e4 * CERTAIN  # so much that the size of the flow does not count beside it


def camera_with(lens: str) -> Camera:
    return Camera(346, 260, 226.4, 226.2, 173.6, 133.7, lens, LENSES[lens])


@pytest.fixture(scope="module", params=LENSES)
def lens(request):
    return request.param


@pytest.fixture(scope="module")
def epipolar(lens) -> NodeEpipolar:
    return NodeEpipolar(camera_with(lens), LATTICE, INLIER_PX)


def random_motions(seed):
    """Unit v, w (some degrees per window) and inverse depths in 1 / windows."""
    rng = np.random.default_rng(seed)
    for _ in range(MOTIONS):
        v = rng.normal(size=3)
        depth = np.exp(rng.uniform(np.log(7), np.log(28), NODES))
        yield v / np.linalg.norm(v), rng.normal(scale=0.02, size=3), 1 / depth


def motion_field(epipolar, v, w, inverse_depth):
    return inverse_depth[:, None] * (epipolar.a @ v) + epipolar.b @ w


def with_outliers(flow, rng):
    """Every fifth node sees something else that moves."""
    flow = flow.copy()
    bad = rng.permutation(NODES)[: NODES // 5]
    flow[bad] += rng.normal(scale=10, size=(len(bad), 2))
    return flow


def angle(a, b):
    return np.degrees(np.arccos(np.clip(abs(a @ b), 0, 1)))


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
    weights = basis(np.linspace(0, 1, LATTICE.times))
    for v, w, inverse_depth in random_motions(2):
        motion = Motion(w + rng.normal(scale=0.01, size=(4, 3)), v + 0.3 * rng.normal(size=(4, 3)))
        fields = [
            motion_field(epipolar, v_t, w_t, inverse_depth)
            for v_t, w_t in zip(weights @ motion.v, weights @ motion.w, strict=True)
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
    motion = Motion(w + rng.normal(scale=0.01, size=(4, 3)), v + 0.2 * rng.normal(size=(4, 3)), 1.3)
    flow = motion_field(epipolar, v, w, inverse_depth)[:, None] + rng.normal(
        size=(NODES, LATTICE.times, 2)
    )

    def residuals(flow, motion):
        if kind == "across":
            return epipolar.residuals(flow, motion)
        return epipolar.structure_residuals(flow, motion, inverse_depth)

    linearised = residuals(flow, motion)
    h = 1e-6
    for step in h * np.eye(2):
        slope = (residuals(flow + step, motion).r - residuals(flow - step, motion).r) / (2 * h)
        np.testing.assert_allclose(linearised.by_flow @ step / h, slope, atol=1e-7)
    for step in h * np.eye(MOTION_UNKNOWNS):
        ahead, behind = (
            residuals(flow, Motion(motion.w + sign * step[:12].reshape(4, 3),
                                   motion.v + sign * step[12:24].reshape(4, 3),
                                   motion.speed + sign * step[24])).r
            for sign in (1, -1)
        )  # fmt: skip
        slope = linearised.by_motion @ step / h
        size = 1 + np.abs(slope).max()
        np.testing.assert_allclose(slope, (ahead - behind) / (2 * h), atol=1e-6 * size)


def test_structure_residuals_vanish_for_the_true_depth_and_speed(epipolar):
    for v, w, inverse_depth in random_motions(11):
        flow = motion_field(epipolar, v, w, inverse_depth)
        motion = Motion.constant(w, v)
        motion = Motion(motion.w, motion.v, 1.6)
        moved = np.repeat(flow[:, None], LATTICE.times, 1)
        r = epipolar.structure_residuals(moved, motion, inverse_depth / 1.6).r
        # Near the focus of expansion the line's norm is softened: by at most `soft`.
        assert np.abs(r).max() < epipolar.soft * inverse_depth.max()
        assert np.median(np.abs(r)) < 1e-4


def test_rotational_flow_and_its_derivative(epipolar):
    w = np.random.default_rng(4).normal(size=(4, 3))
    flow = epipolar.rotational_flow(Motion(w, np.ones((4, 3))))
    for q, s in enumerate(np.linspace(0, 1, LATTICE.times)):
        np.testing.assert_allclose(flow[:, q], epipolar.b @ (basis(s) @ w))
    np.testing.assert_allclose(epipolar.rotational_jacobian() @ w.ravel(), flow, atol=1e-10)


@pytest.mark.parametrize("outliers", [False, True])
def test_search_finds_every_motion_within_its_grid(epipolar, outliers):
    """Directions are 16 degrees apart; w follows as far as v's error lets it."""
    rng = np.random.default_rng(5)
    angles = []
    for v, w, inverse_depth in random_motions(5):
        flow = motion_field(epipolar, v, w, inverse_depth)
        flow = with_outliers(flow, rng) if outliers else flow
        found = epipolar.search(flow, CERTAIN)
        best = found.cost.argmin()
        angles.append(angle(found.v[best], v))
        # The rotation can only mistake what v's error leaves of the translational flow.
        assert np.linalg.norm(found.w[best] - w) < np.sin(np.radians(20)) * inverse_depth.max()
    assert max(angles) < 20
    assert np.median(angles) < 8


def test_search_covers_all_directions(epipolar):
    found = epipolar.search(np.zeros((NODES, 2)), CERTAIN)
    np.testing.assert_allclose(np.linalg.norm(found.v, axis=1), 1)
    random = np.random.default_rng(6).normal(size=(5000, 3))
    random /= np.linalg.norm(random, axis=1, keepdims=True)
    nearest = np.degrees(np.arccos(np.clip(np.abs(random @ found.v.T).max(1), 0, 1)))
    assert nearest.max() < 16
    np.testing.assert_allclose(found.residual, 0, atol=1e-20)


def test_score_knows_the_rotation_of_the_true_direction(epipolar):
    rng = np.random.default_rng(70)
    for v, w, inverse_depth in random_motions(7):
        flow = motion_field(epipolar, v, w, inverse_depth)
        found = epipolar.score(v, flow, EXACT)
        np.testing.assert_allclose(found.w[0], w, atol=1e-6)
        assert found.residual < 1e-4  # 1e-8 px^2
        opposite = epipolar.score(-v, flow, EXACT)
        np.testing.assert_allclose(opposite.w, found.w, atol=1e-9)
        assert opposite.cost == pytest.approx(found.cost, abs=1e-9)
        wrong = epipolar.score(np.cross(v, rng.normal(size=3)), flow, EXACT)
        assert wrong.residual > found.residual + 10


def test_score_and_search_agree(epipolar):
    v, w, inverse_depth = next(random_motions(8))
    flow = with_outliers(motion_field(epipolar, v, w, inverse_depth), np.random.default_rng(8))
    found = epipolar.search(flow, CERTAIN)
    for k in (0, 17, 63):
        one, same = epipolar.score(found.v[k], flow, CERTAIN), found.at(k)
        for name in ("v", "w", "residual", "size"):
            np.testing.assert_allclose(getattr(one, name), getattr(same, name), rtol=1e-9)


def slow_best_rotation(epipolar, v, flow, information):
    """Least squares across and along the lines, reweighted thrice after Geman and McClure.

    Along the lines a fiftieth of each node counts, with the variance that the flow there has had.

    Returns:
        w (3,), its cost of size, and the unit normals (nodes, 2).
    """
    line = epipolar.a @ v
    squared = (line**2).sum(-1) + epipolar.soft**2
    tangent = line / np.sqrt(squared)[:, None]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], -1)
    frames = [(normal, np.einsum("ni,nij,nj->n", normal, information, normal)),
              (tangent, np.einsum("ni,nij,nj->n", tangent, information, tangent))]  # fmt: skip
    of_length = frames[1][1]
    robust, along, prior = np.ones(NODES), np.zeros(NODES), 0.0
    for _ in range(4):
        weights = np.concatenate([robust * frames[0][1], along])
        rows = np.concatenate([np.einsum("ni,nij->nj", e, epipolar.b) for e, _ in frames])
        target = np.concatenate([(e * flow).sum(-1) for e, _ in frames])
        matrix = (weights[:, None] * rows).T @ rows + prior * np.eye(3)
        w = np.linalg.solve(matrix, (weights * target) @ rows)
        left = target - rows @ w
        across, q = left[:NODES], left[NODES:]
        robust = 1 / (1 + (across / INLIER_PX) ** 2) ** 2
        counted = robust * of_length
        excess = of_length * squared * (counted @ (q**2 + 0.09)) / (counted @ squared)
        along = 0.02 * counted / (1 + excess)
        prior = 1 / (w @ w + 0.09 / epipolar.px_per_rad**2)
    size = 0.02 * robust @ (np.log(1 + excess) + of_length * q**2 / (1 + excess))
    size += np.log(w @ w * epipolar.px_per_rad**2 + 0.09)
    return w, size, normal


def slow_cost(left, normal, information, inlier):
    """Geman and McClure's cost of what is across the lines, or of all from behind the camera."""
    across = (normal * left).sum(-1, keepdims=True) * normal
    along = normal[:, 1] * left[:, 0] - normal[:, 0] * left[:, 1]
    costs = []
    for sign in (1, -1):
        rest = np.where((sign * along > 0)[:, None], across, left)
        squares = np.einsum("ni,nij,nj->n", rest, information, rest)
        costs.append(np.sum(squares / (1 + (rest**2).sum(-1) / inlier**2)))
    return min(costs)


def test_score_and_search_are_reweighted_least_squares(epipolar):
    """On a flow with errors and outliers, seen by edges of all directions."""
    rng = np.random.default_rng(12)
    v, w, inverse_depth = next(random_motions(12))
    flow = with_outliers(motion_field(epipolar, v, w, inverse_depth), rng)
    flow = flow + rng.normal(scale=0.3, size=flow.shape)
    edges = rng.normal(size=(NODES, 2, 2))
    information = edges @ np.swapaxes(edges, 1, 2)
    expected, size, normal = slow_best_rotation(epipolar, v, flow, information)
    found = epipolar.score(v, flow, information)
    np.testing.assert_allclose(found.w[0], expected, rtol=1e-5, atol=1e-8)
    left = flow - epipolar.b @ expected
    residual = slow_cost(left, normal, information, INLIER_PX)
    assert found.residual[0] == pytest.approx(residual, rel=1e-5)
    assert found.size[0] == pytest.approx(size, rel=1e-6)
    np.testing.assert_allclose(found.cost, found.residual + found.size)


def test_without_sizes_a_weak_flow_is_not_drawn_to_zero(epipolar):
    """What a gyro's bias is learned from must not be biased itself."""
    v, w, inverse_depth = next(random_motions(15))
    flow = 0.1 * motion_field(epipolar, v, w, inverse_depth)
    sized, plain = (epipolar.score(v, flow, CERTAIN / 30, sized=on) for on in (True, False))
    np.testing.assert_allclose(plain.w[0], 0.1 * w, atol=1e-6)
    assert np.linalg.norm(sized.w) < 0.999 * np.linalg.norm(plain.w)
    for motions in (plain, epipolar.search(flow, CERTAIN, sized=False),
                    epipolar.rotation(flow, CERTAIN, sized=False)):  # fmt: skip
        np.testing.assert_array_equal(motions.size, 0)


def test_of_two_motions_that_leave_the_same_that_of_less_flow_is_likelier(epipolar):
    """A quarter of the depth makes four times the flow along the same lines."""
    v, w, inverse_depth = next(random_motions(14))
    far, near = (
        epipolar.score(v, motion_field(epipolar, v, w, scale * inverse_depth), CERTAIN)
        for scale in (0.25, 1.0)
    )
    assert far.size < near.size
    slow, quick = (epipolar.rotation(epipolar.b @ (scale * w), CERTAIN) for scale in (0.25, 1.0))
    # The probability falls with |w|, where the flow is much larger than what nobody sees.
    assert quick.size[0] - slow.size[0] == pytest.approx(2 * np.log(4), abs=0.1)


@pytest.mark.parametrize("outliers", [False, True])
def test_rotation(epipolar, outliers):
    rng = np.random.default_rng(9)
    for _, w, _ in random_motions(9):
        flow = epipolar.b @ w
        flow = with_outliers(flow, rng) if outliers else flow
        found = epipolar.rotation(flow, CERTAIN)
        np.testing.assert_allclose(found.w[0], w, atol=2e-4 if outliers else 1e-9)
        assert (found.residual < 1e-9) != outliers
        np.testing.assert_array_equal(found.v, 0)


def test_nodes_without_evidence_do_not_count(epipolar):
    v, w, inverse_depth = next(random_motions(10))
    flow = motion_field(epipolar, v, w, inverse_depth)
    information = EXACT.copy()
    flow[: NODES // 2], information[: NODES // 2] = 100.0, 0.0
    found = epipolar.score(v, flow, information)
    np.testing.assert_allclose(found.w[0], w, atol=1e-6)
    assert found.residual < 1e-6


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


def test_motion_moves_by_its_control_points_and_keeps_the_scale_of_v():
    w, v = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.6, 0.8])
    motion = Motion.constant(w, v)
    np.testing.assert_allclose(motion.at(0.3), [w, v])
    moved = motion.moved(np.concatenate([np.full(12, 0.5), 2 * motion.v.ravel(), [0.25]]))
    np.testing.assert_allclose(moved.at(0.8), [w + 0.5, v])
    assert (motion.speed, moved.speed) == (1.0, 1.25)
    assert np.linalg.norm(moved.v.mean(axis=0)) == pytest.approx(1)
