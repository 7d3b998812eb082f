"""How far the motion rests on a part of the patches."""

from dataclasses import replace

import numpy as np
import pytest
from small_problem import DEPTHS, NODES, NOISE, T, V, W, prior, problem, seen_by, start, truth

from emoflow_ros.core.back_end.adjustment import Adjusted, adjust
from emoflow_ros.core.back_end.adjustment_kernels import Observations
from emoflow_ros.core.back_end.jackknife import (
    ByParts,
    by_farther,
    quarters,
    spread,
    without_quarters,
)
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import interpolated, motion_at

SETTINGS = BackEndSettings()
STEADY = prior(0.01, 0.01)  # as the camera of `small_problem` moves
MIDDLE = 2  # of the nodes


def adjusted(o: Observations, known: Prior = STEADY, *, translates: bool = True) -> Adjusted:
    outlier = SETTINGS.outlier
    return adjust(o, start(), known, outlier, 60, DEPTHS, translates=translates)


def variances(o: Observations) -> tuple[float, float, float]:
    """Squared error of w in the middle, and its variance by the jackknife and by the equations."""
    found = adjusted(o)
    motion = motion_at(T, found, int(T[MIDDLE]))
    by_quarters = spread(without_quarters(o, found, SETTINGS)[MIDDLE])
    error = motion.angular - W
    return float(error @ error), float(np.trace(by_quarters)), float(np.trace(motion.covariance))


def test_errors_that_are_independent_are_told_as_by_the_equations():
    _, by_quarters, by_equations = np.mean([variances(problem(seed=s)) for s in range(40)], axis=0)
    assert 0.5 < by_quarters / by_equations < 2.5


def test_an_error_that_a_part_of_the_image_shares_is_told():
    o = problem()
    right_above = (o.bearing[o.patch] > [0.1, 0.1]).all(axis=1)
    o = o._replace(seen=o.seen + np.where(right_above, 1.5 * NOISE * o.node, 0.0)[:, None])
    squared, by_quarters, by_equations = variances(o)
    assert squared > 9 * by_equations
    assert squared < 9 * by_quarters


def test_each_quarter_holds_as_many_patches():
    bearing = np.random.default_rng(0).normal(size=(40, 2))
    assert np.bincount(quarters(bearing)).tolist() == [10, 10, 10, 10]
    for part in range(4):  # none of them reaches over the middle column
        assert len(np.unique(bearing[quarters(bearing) == part, 0] > np.median(bearing[:, 0]))) == 1


def test_patches_at_one_place_are_one_part():
    assert len(np.unique(quarters(np.tile([0.3, -0.2], (5, 1))))) == 1


def test_of_a_camera_that_only_rotates_too():
    o = problem()
    changes = without_quarters(o, adjusted(o, translates=False), SETTINGS)
    assert changes.shape == (NODES, 4, 3)
    assert np.isfinite(changes).all()
    assert (np.abs(changes).max(axis=(0, 2)) > 0).all()


@pytest.mark.parametrize("factor", [0.0, np.nan])
def test_quarters_without_which_there_is_no_minimum_change_nothing(factor: float):
    o = problem()
    found = adjusted(o)
    nothing = replace(found, matrix=factor * found.matrix)
    assert not without_quarters(o, nothing, SETTINGS).any()


@pytest.mark.parametrize("seed", range(3))
def test_one_step_goes_a_good_part_of_the_way_of_an_adjustment_without_a_quarter(seed: int):
    o = problem(seed=seed)
    found, part = adjusted(o), quarters(o.bearing)[o.patch]
    changes = without_quarters(o, found, SETTINGS)
    for quarter in range(4):
        kept = part != quarter
        others = o._replace(
            patch=o.patch[kept], node=o.node[kept], seen=o.seen[kept], root=o.root[kept]
        )
        again = adjusted(others).x.angular - found.x.angular
        one, all_of_it = np.linalg.norm(changes[:, quarter]), np.linalg.norm(again)
        assert np.sum(changes[:, quarter] * again) > 0.7 * one * all_of_it
        assert 0.4 < one / all_of_it < 1


def test_what_all_quarters_agree_on_has_no_spread():
    assert spread(np.zeros((4, 3))) == pytest.approx(np.zeros((3, 3)))
    apart = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 2.0, 0], [0, -2.0, 0]])
    assert spread(apart) == pytest.approx(np.diag([1.5, 6.0, 0.0]))


def with_a_mover() -> tuple[Observations, Adjusted]:
    """Before a distant background the nearer half moves by itself, downwards; found by its way."""
    x = truth()
    near = x.inverse_depth > np.median(x.inverse_depth)
    x = x._replace(inverse_depth=np.where(near, x.inverse_depth, 0.02 * x.inverse_depth))
    own = x.velocity - [0.0, 0.5, 0.0]  # of the camera, seen from what moves
    mover = x._replace(velocity=own, position=(T - T[-1])[:, None] * 1e-9 * own)
    o, noise = problem(), np.random.default_rng(5)
    places = [
        np.stack([seen_by(way, o.bearing, 0, node) for node in range(NODES)], axis=1)
        for way in (x, mover)
    ]
    seen = np.where(near[:, None, None], places[1], places[0])[o.patch, o.node]
    o = o._replace(seen=seen + NOISE * noise.normal(size=seen.shape))
    return o, adjust(o, mover, STEADY, SETTINGS.outlier, 60, DEPTHS)


def turned_deg(linear: np.ndarray) -> float:
    return float(np.degrees(np.arccos(linear @ V / np.linalg.norm(linear) / np.linalg.norm(V))))


def spread_of_direction_deg(o: Observations, found: Adjusted) -> float:
    linear = motion_at(T, found, int(T[MIDDLE])).linear
    _, of_v = ByParts.of(o, found, STEADY, SETTINGS).spread(T, int(T[MIDDLE]), linear)
    return float(np.degrees(np.sqrt(np.trace(of_v))))


def test_a_direction_that_rests_on_what_moves_by_itself_is_less_sure():
    o, found = with_a_mover()
    assert turned_deg(motion_at(T, found, int(T[MIDDLE])).linear) > 45
    assert spread_of_direction_deg(o, found) > 8
    assert spread_of_direction_deg(problem(), adjusted(problem())) < 2


def test_a_direction_that_rests_on_the_nearer_half_has_half_the_variance_of_the_difference():
    o, found = with_a_mover()
    parts = ByParts.of(o, found, STEADY, SETTINGS)
    assert parts.farther is not None
    middle = int(T[MIDDLE])
    v, u = (interpolated(T, x, middle)[1] for x in (found.x, parts.farther))
    of_w, of_v = parts.spread(T, middle, v)
    assert of_w == pytest.approx(spread(parts.changes[MIDDLE]))
    apart = np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))
    assert np.trace(of_v) == pytest.approx(0.5 * apart**2)
    assert of_v @ v == pytest.approx(np.zeros(3), abs=1e-9)


def test_of_a_rotation_there_is_no_farther_half():
    o = problem()
    turning = adjusted(o, translates=False)
    assert by_farther(o, turning, STEADY, SETTINGS) is None
    parts = ByParts.of(o, turning, STEADY, SETTINGS)
    assert not parts.spread(T, int(T[MIDDLE]), V)[1].any()


def test_a_half_that_diverges_tells_nothing():
    o = problem()
    found = adjusted(o)
    assert by_farther(o._replace(seen=np.nan * o.seen), found, STEADY, SETTINGS) is None
