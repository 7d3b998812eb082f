"""The adjustment against SciPy's least squares, and what its covariance and priors say."""

from dataclasses import replace

import numpy as np
import pytest
from independent_adjustment import best_by_scipy, with_gyro, with_windows
from scipy.spatial.transform import Rotation
from small_problem import (
    DEPTHS,
    NODES,
    NOT_ROBUST,
    PATCHES,
    T,
    V,
    W,
    prior,
    problem,
    seen_by,
    start,
    truth,
)

from emoflow_ros.core.back_end.adjustment import Adjusted, adjust
from emoflow_ros.core.back_end.adjustment_kernels import (
    NODE,
    Observations,
    Unknowns,
    observation_cost,
)
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import along, motion_at
from emoflow_ros.core.back_end.walks import Walks


def adjusted(observations: Observations, **options) -> Adjusted:
    return adjust(observations, start(), prior(), NOT_ROBUST, 40, DEPTHS, **options)


@pytest.mark.parametrize(
    "known", [prior(), with_windows(NOT_ROBUST), with_gyro()], ids=["places", "windows", "gyro"]
)
def test_the_optimum_is_that_of_scipy(known: Prior):
    found = adjust(problem(), start(), known, NOT_ROBUST, 40, DEPTHS)
    best, covariance = best_by_scipy(known)
    assert found.cost == pytest.approx(best.cost, rel=1e-3)
    rates = [NODE * (NODES - 2) + 6 + k for k in range(3)]
    own = np.sqrt(np.diag(found.covariance)[rates])
    assert own == pytest.approx(np.sqrt(np.diag(covariance)[rates]), rel=0.05)


def test_without_noise_the_motion_is_found():
    found = adjusted(problem(noise=0.0))
    motion = motion_at(T, found, int(T[2]))
    assert np.degrees(np.linalg.norm(motion.angular - W)) < 0.05
    direction = motion.linear / np.linalg.norm(motion.linear)
    assert direction == pytest.approx(V / np.linalg.norm(V), abs=5e-3)


def test_errors_are_those_of_the_covariance():
    squares = []
    for seed in range(40):
        steady = prior(0.01, 0.01)  # as the camera of `truth` moves
        found = adjust(problem(seed=seed), start(), steady, NOT_ROBUST, 60, DEPTHS)
        motion = motion_at(T, found, int(T[2]))
        error = motion.angular - W
        squares.append(error @ np.linalg.solve(motion.covariance, error) / 3)
    assert 0.3 < np.mean(squares) < 1.5


def test_wrong_places_do_not_pull():
    o = problem()
    wrong = np.arange(len(o.patch)) % 6 == 0
    o = o._replace(seen=o.seen + np.where(wrong[:, None], [0.03, -0.02], 0.0))
    robust = adjust(o, start(), prior(), 2.0, 40, DEPTHS)
    plain = adjusted(o)
    errors = [
        np.degrees(np.linalg.norm(motion_at(T, a, int(T[2])).angular - W)) for a in (robust, plain)
    ]
    assert errors[0] < 1.5
    assert errors[1] > 3 * errors[0]


def test_a_camera_that_only_rotates_costs_more_where_there_is_parallax():
    full, still = adjusted(problem()), adjusted(problem(), translates=False)
    assert still.cost > full.cost + PATCHES
    assert not still.x.velocity.any()
    assert not still.x.position.any()


def test_a_measured_mean_turns_the_way_as_its_covariance_says():
    share = np.array([[0.0, 1.0, 1.0, 0.0, 0.0]]) / 2
    measured = prior()._replace(
        measured=np.array([[1.0, 0.0, 0.0]]), measured_share=share,
        measured_root=np.array([np.eye(3) / 1e-6]), measured_outlier=1e9,
        measured_biased=np.zeros(1, np.bool_),
    )  # fmt: skip
    found = adjust(problem(), start(), measured, NOT_ROBUST, 60, DEPTHS)
    turn = Rotation.from_matrix(found.x.rotation[1].T @ found.x.rotation[3]).as_rotvec()
    assert turn / 0.08 == pytest.approx([1.0, 0.0, 0.0], abs=1e-2)


def test_a_window_far_from_the_places_hardly_pulls():
    free = adjusted(problem()).x.angular
    pulled = {
        outlier: adjust(problem(), start(), with_windows(outlier), NOT_ROBUST, 60, DEPTHS)
        for outlier in (2.0, NOT_ROBUST)
    }
    apart = {k: np.abs(found.x.angular - free).max() for k, found in pulled.items()}
    assert apart[2.0] < 0.25 * apart[NOT_ROBUST]


def test_nodes_follow_a_hand_that_trembles_within_a_window():
    swing = np.array([3.0, 0.0, 0.0]) * np.array([-1, 0, 1, 0, -1])[:, None]  # rad/s, 6 Hz
    fine = np.linspace(T[0], T[-1], 401).astype(np.int64)
    rates = W + np.stack([np.interp(fine, T, swing[:, k]) for k in range(3)], axis=1)
    x = along(fine, rates, np.tile(V, (len(fine), 1)), truth().inverse_depth)
    x = x._replace(
        rotation=x.rotation[::100], position=x.position[::100], angular=x.angular[::100],
        velocity=x.velocity[::100],
    )  # fmt: skip
    o = problem()
    seen = np.concatenate([seen_by(x, o.bearing, 0, k) for k in range(1, NODES)])
    steady = prior(walk=15.0)._replace(  # its mean is right, and sure
        measured=W[None], measured_share=np.array([[1.0, 1.0, 1.0, 1.0, 0.0]]) / 4,
        measured_root=np.eye(3)[None] / 1e-3, measured_biased=np.zeros(1, np.bool_),
    )  # fmt: skip
    found = adjust(o._replace(seen=seen), start(), steady, NOT_ROBUST, 60, DEPTHS)
    apart = found.x.angular[:, 0] - W[0]
    assert apart[2] > 0.6 * 3.0  # a node at a kink rounds it off
    assert np.abs(apart[[1, 3]]).max() < 0.2 * 3.0


def test_a_place_that_is_no_number_is_refused():
    o = problem()
    with pytest.raises(np.linalg.LinAlgError):
        adjusted(o._replace(seen=np.full_like(o.seen, np.nan)))


def test_the_information_on_a_depth_is_the_curvature_of_the_cost():
    found, o, squares = adjusted(problem()), problem(), np.empty(PATCHES * (NODES - 1))
    step = 1e-4
    for j in (0, 7, 29):
        cost = []
        for change in (-step, 0.0, step):
            depths = found.x.inverse_depth.copy()
            depths[j] += change
            x = found.x._replace(inverse_depth=depths)
            cost.append(observation_cost(o, x, NOT_ROBUST, squares))
        curvature = (cost[0] - 2 * cost[1] + cost[2]) / step**2
        by_places = curvature - 1 / o.depth_sd[j] ** 2
        assert found.of_depth[j] == pytest.approx(by_places, rel=0.02)
    scaled = found.of_unit_depth()
    scale = found.x.inverse_depth[0] / scaled.x.inverse_depth[0]
    assert scaled.of_depth == pytest.approx(scale**2 * found.of_depth)


def of_motion(x: Unknowns, free: np.ndarray) -> Adjusted:
    """An adjustment that is sure of its motion."""
    return Adjusted(x, 0.0, np.zeros(1), 1e9 * np.eye(len(free)), free, True, np.ones(1))


def test_walks_are_learnt_from_restless_and_from_steady_motion():
    settings = BackEndSettings()
    rng = np.random.default_rng(0)
    for walk in (0.3, 3.0):  # rad/s per square root of a second
        steps = walk * np.sqrt(0.04) * rng.normal(size=(12, 3))
        t = np.arange(12) * 40_000_000
        x = along(t, np.cumsum(steps, axis=0), np.zeros((12, 3)), np.ones(1))
        free = np.arange(12 * NODE)
        known = of_motion(x, free)
        walks = Walks.unknown(settings)
        for _ in range(40):
            walks = walks.learnt(known, np.diff(t) * 1e-9, settings)
        assert np.sqrt(walks.angular) == pytest.approx(walk, rel=0.35)


def test_the_restlessness_of_a_camera_at_rest_does_not_vanish():
    settings, t = BackEndSettings(), np.arange(12) * 60_000_000
    x, free = along(t, np.zeros((12, 3)), np.zeros((12, 3)), np.ones(1)), np.arange(12 * NODE)
    known, walks = of_motion(x, free), None
    for _ in range(40):
        walks = (walks or Walks.unknown(settings)).learnt(known, np.diff(t) * 1e-9, settings)
    assert walks is not None
    assert np.degrees(np.sqrt(walks.angular)) == pytest.approx(3)
    assert np.sqrt(walks.velocity) == pytest.approx(0.1)


def test_the_mean_cost_is_one_where_all_is_right_and_more_where_places_do_not_fit():
    settings = BackEndSettings()
    good, bad = (
        replace(of_motion(truth(), np.arange(3)), squares=np.full(10, s)) for s in (0.5, 9.0)
    )
    assert good.mean_cost(settings) == pytest.approx(0.25 / 1.125 / 0.25)
    assert bad.mean_cost(settings) > 5
