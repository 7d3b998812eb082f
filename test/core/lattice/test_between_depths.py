"""Inverse depths at nodes, from points at which they are known."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.lattice.between_depths import BetweenDepths
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.refinement import Depths

SIZE = 173, 130
RHO = 0.08  # ways per window


def closer_than(spacing_px: float) -> Lattice:
    """Nodes three times as close as those of a lattice of this spacing."""
    lattice = Lattice.with_spacing(*SIZE, spacing_px)
    return replace(lattice, columns=3 * lattice.columns - 2, rows=3 * lattice.rows - 2)


FINE = closer_than(26.0)


def all_over() -> np.ndarray:
    """Points (N, 2) px all over the image."""
    x, y = np.meshgrid(np.arange(4.0, SIZE[0], 8), np.arange(4.0, SIZE[1], 8))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def floor_at(points: np.ndarray) -> np.ndarray:
    """Inverse depths of a floor."""
    return RHO * (0.5 + points[:, 1] / SIZE[1])


def between(points: np.ndarray, rho: np.ndarray, lattice: Lattice = FINE) -> np.ndarray:
    return BetweenDepths(lattice)(Depths(points, rho, np.ones(len(points))))[0].ravel()


def test_depths_of_little_weight_hardly_count():
    points, odd = all_over(), np.arange(len(all_over())) % 2
    depths = Depths(points, np.where(odd, RHO, 5 * RHO), np.where(odd, 1.0, 1e-3))
    found, near = BetweenDepths(FINE)(depths)
    assert found == pytest.approx(RHO, rel=0.05)
    every = BetweenDepths(FINE)(replace(depths, weight=np.ones(len(points))))[1]
    assert near.sum() == pytest.approx(0.5 * every.sum(), rel=0.02)


def test_an_outlier_of_little_weight_changes_nothing():
    points = all_over()[all_over()[:, 1] < 90]
    outlier = np.array([[86.0, 100.0]])
    alone = between(points, floor_at(points))
    rho = np.append(floor_at(points), 100 * RHO)
    weight = np.append(np.ones(len(points)), 1e-6)
    found, _ = BetweenDepths(FINE)(Depths(np.concatenate([points, outlier]), rho, weight))
    assert found.ravel() == pytest.approx(alone, rel=0.01)


def test_at_an_edge_of_depth_what_is_farther_counts_more():
    points, apart = all_over(), FINE.pixels[:, 0] - SIZE[0] / 2
    near = points[:, 0] > SIZE[0] / 2
    found = between(points, np.where(near, 2 * RHO, RHO))
    assert found[(apart > -5) & (apart < 5)].mean() < 1.35 * RHO  # alike it were 1.42
    assert found[apart < -12] == pytest.approx(RHO, rel=0.03)
    assert found[apart > 24] == pytest.approx(2 * RHO, rel=0.01)


def test_where_no_point_is_near_the_nearest_decide():
    known, nodes = all_over()[all_over()[:, 1] < 90], FINE.pixels
    found, last = between(known, floor_at(known)), floor_at(known).max()
    outside, among = nodes[:, 1] > 110, (nodes[:, 1] > 10) & (nodes[:, 1] < 80)
    assert found[outside] == pytest.approx(0.9 * last, rel=0.05)  # the mean of all: 0.76 of it
    assert found[among] == pytest.approx(floor_at(nodes)[among], abs=0.06 * RHO)


def test_depths_between_points_lie_within_theirs():
    known = np.random.default_rng(0).uniform([20, 10], [80, 120], (300, 2))
    rho = RHO * (1 + 0.03 * (known[:, 0] - 50))
    found = between(known, rho)
    assert rho.min() <= found.min() < 0.1 * rho.max()
    assert 0.8 * rho.max() < found.max() <= rho.max()


@pytest.mark.parametrize("spacing_px", [8.0, 26.0, 200.0])
def test_depths_reach_nodes_however_far_apart_these_are(spacing_px):
    known, lattice = all_over(), closer_than(spacing_px)
    nodes = lattice.pixels
    inside = (nodes[:, 1] > 20) & (nodes[:, 1] < 110)
    found = between(known, floor_at(known), lattice)
    assert found[inside] == pytest.approx(floor_at(nodes)[inside], abs=0.06 * RHO)


def test_one_depth_is_that_of_the_whole_scene():
    assert between(np.array([[20.0, 30.0]]), np.array([RHO])) == pytest.approx(RHO)
