"""The motions that may explain a flow, and what is claimed of them."""

import numpy as np
import pytest

from emoflow_ros.core.lattice.uncertainty import (
    Explanations,
    PossibleMotions,
    temperature,
    trusted,
    without_translation,
)

W = np.array([0.02, -0.05, 0.03])  # rad per window
V = np.array([0.6, 0.0, 0.8])
FOCAL_PX = 226.0
NEVER = 1e9  # more cost than any flow has


def covariance_of(possible, *, known=None, parallax_px=5.0) -> np.ndarray:
    return possible.covariance(parallax_px, FOCAL_PX, known)


def turned(angle: float) -> np.ndarray:
    axis = np.array([0.0, 1.0, 0.0])
    return np.cos(angle) * V + np.sin(angle) * np.cross(axis, V)


def explain(v, w, excess, residual: float = 0.0) -> Explanations:
    """Motions (M, 3) that cost an excess (M,)."""
    v, w = np.atleast_2d(v), np.atleast_2d(w)
    return Explanations(v, w, np.full(len(v), residual), np.broadcast_to(excess, len(v)))


def weigh(
    w, v, excess: float, turn_excess: float = NEVER, temperature: float = 1.0
) -> PossibleMotions:
    """One other motion that translates, and a camera that only rotates, by what they cost more."""
    turn = explain(np.zeros(3), np.zeros(3), turn_excess)
    return PossibleMotions.weigh(
        (W, V), explain(V, W, 0.0), explain(v, w, excess), turn, temperature
    )


def test_two_motions_that_explain_the_flow_alike_give_their_mean_and_spread():
    """Half of the way between them, and the square of it; the sign of v does not matter."""
    possible = weigh(np.add(W, [0.0, 0.04, 0.0]), -turned(0.4), 0.0)
    apart = turned(0.4) - V
    np.testing.assert_allclose(possible.mean, [0.0, 0.02, 0.0, *(apart / 2)], atol=1e-15)
    half = possible.mean
    np.testing.assert_allclose(possible.spread, np.outer(half, half), atol=1e-15)


@pytest.mark.parametrize("excess", [-3.0, 0.5, 2.0, 6.0])
def test_a_motion_is_as_likely_as_the_exponential_of_half_its_cost(excess):
    weight = np.exp(-0.5 * excess)
    possible = weigh(np.add(W, [0.04, 0.0, 0.0]), V, excess)
    assert possible.mean[0] == pytest.approx(0.04 * weight / (1 + weight))


def test_a_camera_that_only_turns_weighs_as_much_as_all_directions():
    others = explain(np.tile(V, (7, 1)), np.tile(W, (7, 1)), NEVER)
    turn = explain(np.zeros(3), np.zeros(3), 0.0)
    possible = PossibleMotions.weigh((W, V), explain(V, W, 0.0), others, turn)
    np.testing.assert_allclose(possible.mean[:3], -7 / 8 * W)


def heat_of(misfit: float, usable: int = 100) -> float:
    """Temperature of 150 nodes, the first of them usable, with a cost of so much per node."""
    information = trusted(np.tile(1e9 * np.eye(2), (150, 1, 1)))
    least, more = (explain(V, W, 0.0, factor * misfit * usable) for factor in (1, 3))
    found, swapped = (
        temperature(*pair, np.arange(150) < usable, information)
        for pair in ((least, more), (more, least))
    )
    assert found == swapped
    return found


def test_the_temperature_is_the_root_of_what_is_left_within_bounds():
    usual = np.sqrt([heat_of(misfit) / heat_of(misfit / 4) for misfit in (0.13, 0.26, 0.4)])
    np.testing.assert_allclose(usual, np.sqrt(2))
    assert 0 < heat_of(1e-4) == heat_of(1e-5) < heat_of(0.1)
    assert heat_of(1e3) == heat_of(1e4) > heat_of(0.4)


def test_the_temperature_is_one_of_a_node_and_not_of_their_number():
    """Nodes where the lens has no inverse do not count."""
    assert heat_of(0.2, usable=50) == pytest.approx(heat_of(0.2, usable=100))


def test_costs_count_less_at_a_higher_temperature():
    possible = weigh(np.add(W, [0.04, 0.0, 0.0]), V, 2.0, temperature=2.0)
    assert possible.mean[0] == pytest.approx(0.04 * np.exp(-0.5) / (1 + np.exp(-0.5)))


def test_a_cost_far_below_the_present_one_is_no_overflow():
    possible = weigh(np.zeros(3), V, -1e6)
    np.testing.assert_allclose(possible.mean[:3], -W)


NO_OTHER = PossibleMotions(np.zeros(6), np.zeros((6, 6)))


def sigmas(parallax_px: float) -> tuple[float, float]:
    """Standard deviations of w and of v, which are alike in all directions."""
    covariance = covariance_of(NO_OTHER, parallax_px=parallax_px)
    of_w, of_v = covariance[0, 0], covariance[3, 3]
    np.testing.assert_allclose(covariance, np.diag(np.repeat([of_w, of_v], 3)))
    return float(np.sqrt(of_w)), float(np.sqrt(of_v))


def test_without_other_motions_an_error_of_the_flow_stays():
    """0.15 px; of v it is the larger the shorter the parallax, which is 0.3 px at least."""
    of_w, near = sigmas(2.0)
    assert of_w == pytest.approx(0.15 / FOCAL_PX)
    assert near == pytest.approx(0.15 / 2.0)
    assert sigmas(1.0) == (of_w, pytest.approx(2 * near))
    assert sigmas(0.01) == sigmas(0.0) == (of_w, pytest.approx(0.5))


def test_the_spread_adds_to_the_error():
    possible = weigh(np.add(W, [0.0, 0.04, 0.0]), turned(0.4), 0.0)
    added = covariance_of(possible) - covariance_of(NO_OTHER)
    np.testing.assert_allclose(added, possible.spread, atol=1e-15)


def test_what_is_known_of_w_lessens_its_covariance_and_that_of_v_with_it():
    possible = weigh(np.add(W, [0.0, 0.04, 0.0]), turned(0.4), 0.0)
    known = np.eye(3) / 0.001**2
    free = covariance_of(possible)
    tied = covariance_of(possible, known=known)
    assert np.linalg.eigvalsh(tied[:3, :3]).max() < 0.001**2
    assert np.trace(tied[3:, 3:]) < 0.75 * np.trace(free[3:, 3:])
    np.testing.assert_allclose(np.linalg.inv(tied)[3:, 3:], np.linalg.inv(free)[3:, 3:])


@pytest.mark.parametrize(("angle", "excess", "agree"), [
    (0.5, 0.0, True), (0.7, 0.0, False), (1.2, 0.0, False), (1.2, 20.0, True), (1.2, 4.0, False),
])  # fmt: skip
def test_motions_agree_unless_another_one_far_off_is_possible(angle, excess, agree):
    """Of two directions as likely each is off by half of the angle between them."""
    assert weigh(W, turned(angle), excess).agree is agree


def test_without_travel_only_the_rotation_s_part_is_left():
    covariance = without_translation(np.arange(36.0).reshape(6, 6))
    assert covariance[0, 0] == -1
    np.testing.assert_array_equal(covariance[3:, 3:], np.arange(36.0).reshape(6, 6)[3:, 3:])
    assert np.count_nonzero(covariance[:3]) == 1 and not covariance[3:, :3].any()
