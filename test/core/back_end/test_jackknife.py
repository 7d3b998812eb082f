"""How far the rotation rests on one part of the image."""

from dataclasses import replace

import numpy as np
import pytest
from small_problem import DEPTHS, NODES, NOISE, T, W, prior, problem, start

from emoflow_ros.core.back_end.adjustment import Adjusted, adjust
from emoflow_ros.core.back_end.adjustment_kernels import Observations
from emoflow_ros.core.back_end.jackknife import quarters, spread, without_quarters
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import motion_at

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
