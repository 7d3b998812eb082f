"""Motions that explain a flow: the best rotations, their residuals and their sizes."""

import numpy as np
import pytest
from motion_fields import (
    CERTAIN,
    EXACT,
    INLIER_PX,
    NODES,
    angle,
    motion_field,
    random_motions,
    with_outliers,
)


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
