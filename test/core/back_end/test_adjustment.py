"""The adjustment against SciPy's least squares, and what its covariance and priors say."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation
from small_problem import (
    DEPTHS,
    NODES,
    NOISE,
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
    rotated,
)
from emoflow_ros.core.back_end.bias import seen_bias
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import along, motion_at
from emoflow_ros.core.back_end.walks import Walks


def adjusted(observations: Observations, **options) -> Adjusted:
    return adjust(observations, start(), prior(), NOT_ROBUST, 40, DEPTHS, **options)


def residuals(free: np.ndarray, o: Observations, p: Prior) -> np.ndarray:
    """All residuals of a vector of unknowns about the start, written down independently.

    The last three are a gyro's bias, where a gyro measures.
    """
    begin, bias = start(), np.zeros(3)
    if p.measured_biased.any():
        free, bias = free[:-3], free[-3:]
    nodes = np.zeros((NODES, NODE))
    index = np.ones((NODES, NODE), np.bool_)
    index[-1, :6] = False
    nodes[index] = free[: index.sum()]
    rotation = np.stack([rotated(r, n[:3]) for r, n in zip(begin.rotation, nodes, strict=True)])
    x = Unknowns(
        rotation, begin.position + nodes[:, 3:6], begin.angular + nodes[:, 6:9],
        begin.velocity + nodes[:, 9:], begin.inverse_depth + free[index.sum() :],
    )  # fmt: skip
    rows = []
    for k in range(1, NODES):
        of_node = o.node == k
        rows.append((seen_by(x, o.bearing, 0, k) - o.seen[of_node]).ravel() / NOISE)
    for k, dt in enumerate(p.seconds):
        turn = Rotation.from_matrix(x.rotation[k].T @ x.rotation[k + 1]).as_rotvec()
        noise = np.linalg.cholesky(np.linalg.inv([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
        for density, way, change in (
            (p.angular_walk, turn - dt * x.angular[k], x.angular[k + 1] - x.angular[k]),
            (
                p.velocity_walk,
                x.position[k + 1] - x.position[k] - dt * x.velocity[k],
                x.velocity[k + 1] - x.velocity[k],
            ),
        ):
            rows.append((noise.T @ np.stack([way, change]) / np.sqrt(density)).ravel())
    turns = [r.T @ after for r, after in pairwise(x.rotation)]
    rates = Rotation.from_matrix(turns).as_rotvec() / p.seconds[:, None]
    means = p.measured_share @ np.concatenate([rates, x.angular[-1:]])
    means = means + p.measured_biased[:, None] * bias
    rows.append(np.einsum("mij,mj->mi", p.measured_root, means - p.measured).ravel())
    rows.append(np.linalg.cholesky(p.bias_information).T @ bias)
    rows += [(x.velocity / p.speed_sd).ravel(), (x.inverse_depth - o.depth_mean) / o.depth_sd]
    return np.concatenate(rows)


def with_windows(outlier: float) -> Prior:
    """Windows from the second node to the fourth, and from the third until after the newest."""
    share = np.array([[0.0, 0.5, 0.5, 0.0, 0.0], [0.0, 0.0, 0.3, 0.4, 0.3]])
    rates = np.array([[0.3, -0.1, 0.0], [0.2, 0.0, -0.1]])
    root = np.array([np.eye(3) / 0.02, [[40.0, 10.0, 0.0], [0.0, 60.0, 5.0], [0.0, 0.0, 50.0]]])
    return prior()._replace(
        measured=rates, measured_share=share, measured_root=root, measured_outlier=outlier,
        measured_biased=np.zeros(2, np.bool_),
    )  # fmt: skip


def with_gyro() -> Prior:
    """The same windows by a gyro whose bias is known to 0.1 rad/s, and one more of the lattice."""
    known = with_windows(NOT_ROBUST)
    again = {name: getattr(known, name)[[0, 1, 0]] for name in ("measured_share", "measured_root")}
    return known._replace(
        **again,
        measured=known.measured[[0, 1, 0]] + 0.15 * np.array([[1.0], [1.0], [0.0]]),
        measured_biased=np.array([True, True, False]),
        bias_information=np.diag([100.0, 120.0, 80.0]),
    )


def best_by_scipy(known: Prior) -> tuple[OptimizeResult, np.ndarray]:
    """The optimum, and the covariance of all unknowns."""
    count = NODES * NODE - 6 + PATCHES + 3 * bool(known.measured_biased.any())
    best = least_squares(residuals, np.zeros(count), args=(problem(), known), x_scale="jac")
    return best, np.linalg.inv(best.jac.T @ best.jac)


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


def test_the_bias_of_a_gyro_is_that_of_scipy():
    known = with_gyro()
    found = adjust(problem(), start(), known, NOT_ROBUST, 40, DEPTHS)
    seen = seen_bias(found, known)
    best, covariance = best_by_scipy(known)
    # what the events show, and what was known before, make all that is known
    of_events = np.linalg.inv(seen.covariance)
    posterior = np.linalg.inv(of_events + known.bias_information)
    assert posterior @ of_events @ seen.excess == pytest.approx(best.x[-3:], rel=0.02)
    assert posterior == pytest.approx(covariance[-3:, -3:], rel=0.05, abs=1e-6)
    assert seen.seconds == pytest.approx((T[-1] - T[0]) * 1e-9)


def test_places_show_the_bias_of_a_gyro():
    bias, shares = np.array([0.02, -0.03, 0.01]), np.full((1, NODES), 1 / (NODES - 1))
    shares[0, -1] = 0.0
    known = prior()._replace(
        measured=W[None] + bias, measured_share=shares, measured_root=np.eye(3)[None] / 1e-4,
        measured_biased=np.ones(1, np.bool_), bias_information=np.eye(3) / 0.02**2,
    )  # fmt: skip
    found = adjust(problem(noise=0.0), start(), known, NOT_ROBUST, 60, DEPTHS)
    assert seen_bias(found, known).excess == pytest.approx(bias, abs=2e-3)
    assert seen_bias(found, prior()) is None


def test_where_places_tell_nothing_no_bias_is_seen():
    known, o = with_gyro()._replace(measured_biased=np.ones(3, np.bool_)), problem()
    blind = o._replace(root=1e-9 * o.root)
    assert seen_bias(adjust(o, start(), known, NOT_ROBUST, 40, DEPTHS), known) is not None
    assert seen_bias(adjust(blind, start(), known, NOT_ROBUST, 40, DEPTHS), known) is None


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
