"""Smooth errors of the flow and other motions, as parts of the egomotion's covariance."""

import numpy as np
import pytest

from emoflow_ros.core.belief import Belief
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.uncertainty import MotionUncertainty, without_travel

CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)
LATTICE = Lattice.with_spacing(346, 260, 26.0)
EPIPOLAR = NodeEpipolar(CAMERA, LATTICE, 0.7)
DURATION = 0.1
W = np.array([0.02, -0.05, 0.03])  # rad per window
V = np.array([0.6, 0.0, 0.8])
NODES = len(LATTICE.pixels)
INFORMATION = np.tile(50.0 * np.eye(2), (NODES, 1, 1))
NO_WHITE_ERROR = np.eye(6) * 1e-18


def belief() -> Belief:
    return Belief(0, W / DURATION, V, NO_WHITE_ERROR + np.pad(np.outer(V, V), (3, 0)))


@pytest.fixture
def uncertainty() -> MotionUncertainty:
    return MotionUncertainty(LATTICE, EPIPOLAR)


def smooth_errors():
    """Polynomials of second order over the image, on one component at a time: (12, nodes, 2)."""
    x, y = 2 * LATTICE.pixels.T / np.array([[345.0], [259.0]]) - 1
    for shape in (np.ones_like(x), x, y, x * y, x**2 - 1 / 3, y**2 - 1 / 3):
        for component in np.eye(2):
            yield shape[:, None] * component


def test_a_rotation_s_covariance_is_that_of_refits_to_flows_with_smooth_errors(uncertainty):
    flow = EPIPOLAR.b @ W
    found = uncertainty.of_rotation(belief(), flow, INFORMATION, DURATION)[3:, 3:]
    b = EPIPOLAR.b.reshape(-1, 3)
    errors = [np.linalg.lstsq(b, 0.15 * e.ravel(), rcond=None)[0] for e in smooth_errors()]
    expected = sum(np.outer(e, e) for e in errors) / DURATION**2
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=0.02 * np.trace(expected))


def test_travel_before_a_near_and_rugged_scene_is_more_certain(uncertainty):
    """The same rotation and relief, three times as near."""
    relief = 1 + 0.5 * np.sin(LATTICE.pixels @ [0.05, 0.03])
    sigma = []
    for size in (0.03, 0.09):
        flow = EPIPOLAR.b @ W + size * relief[:, None] * (EPIPOLAR.a @ V)
        covariance = uncertainty.of_travel(belief(), flow, INFORMATION, DURATION)
        assert np.linalg.eigvalsh(covariance).min() > -1e-9
        np.testing.assert_allclose(covariance[:3, :3] @ V, 0, atol=1e-6)
        sigma.append(np.sqrt(np.trace(covariance[:3, :3])))
    assert sigma[1] < 0.75 * sigma[0]


def turned(angle: float) -> np.ndarray:
    axis = np.array([0.0, 1.0, 0.0])
    return np.cos(angle) * V + np.sin(angle) * np.cross(axis, V)


def other(w, v, excess: float, turn_excess: float = 1e9):
    """One other motion that travels, and a camera that only turns, by what they cost more."""
    return (w[None], v[None], np.array([excess])), (np.zeros(3), turn_excess)


@pytest.mark.parametrize(("angle", "excess", "claims"), [
    (0.5, 0.0, True), (1.2, 0.0, False), (1.2, 200.0, True), (1.2, 40.0, True), (1.5, 10.0, False),
])  # fmt: skip
def test_a_direction_is_claimed_unless_another_one_far_off_is_possible(
    uncertainty, angle, excess, claims
):
    uncertainty.weigh_others((W, V), *other(W, turned(angle), excess))
    assert [uncertainty.claims(V) for _ in range(4)][-1] is claims


def test_a_direction_is_claimed_once_two_of_the_last_windows_have_told_the_same(uncertainty):
    """Signs count, 40 degrees may lie between, and none of three may have told another one."""
    directions = [V, V, turned(0.6), V, turned(-0.6), V, V, V, V, -V]
    expected = [False, False, True, True, False, True, True, True, True, False]
    assert [uncertainty.claims(v) for v in directions] == expected


def test_a_window_of_doubt_tells_no_direction(uncertainty):
    assert [uncertainty.claims(V) for _ in range(3)] == [False, False, True]
    uncertainty.weigh_others((W, V), *other(W, turned(1.2), 0.0))
    assert not uncertainty.claims(V)
    uncertainty.weigh_others((W, V), *other(W, V, 1e9))
    assert uncertainty.claims(V)  # two of three
    uncertainty.forget()
    assert [uncertainty.claims(V) for _ in range(3)] == [False, False, True]


def test_two_motions_that_explain_the_flow_alike_give_their_mean_and_spread(uncertainty):
    """Half of the way between them, and the square of it."""
    other_w = W + np.array([0.0, 0.04, 0.0])
    flow = EPIPOLAR.b @ W + 0.05 * (EPIPOLAR.a @ V)
    before = uncertainty.of_travel(belief(), flow, INFORMATION, DURATION)
    uncertainty.weigh_others((W, V), *other(other_w, -turned(0.4), 0.0))
    np.testing.assert_allclose(uncertainty.mean_rotation, [0.0, 0.02, 0.0], atol=1e-15)
    after = uncertainty.of_travel(belief(), flow, INFORMATION, DURATION)
    added = after - before
    assert added[4, 4] == pytest.approx((0.02 / DURATION) ** 2)
    assert np.trace(added[:3, :3]) == pytest.approx((0.5 * np.sin(0.4)) ** 2)
    uncertainty.forget()
    again = uncertainty.of_travel(belief(), flow, INFORMATION, DURATION)
    np.testing.assert_array_equal(again, before)


def test_a_camera_that_only_turns_weighs_as_much_as_twenty_directions(uncertainty):
    uncertainty.weigh_others((W, V), *other(W, V, 1e9, turn_excess=0.0))
    np.testing.assert_allclose(uncertainty.mean_rotation, -20 / 21 * W)


def test_a_jump_of_w_counts_and_an_even_change_does_not(uncertainty):
    """The covariance of 645 px^-2 of evidence is scaled by 0.41, and by 0.2 for v."""
    evidence = np.array([644.0])
    small = np.eye(6) * 1e-9
    variances = [
        uncertainty.calibrated(small, uncertainty.jump_of(np.array([w, 0.0, 0.0])), evidence)[3, 3]
        for w in (0.1, 0.2, 0.3, 0.4, 0.9)
    ]
    first = 0.05 * np.radians(10) ** 2
    expected = [first, first, 0, 0, 0.05 * 0.4**2]
    np.testing.assert_allclose(variances, np.add(expected, 0.41e-9), rtol=1e-6)


def test_more_evidence_makes_the_covariance_smaller_but_for_jumps(uncertainty):
    usual, much = (
        MotionUncertainty(LATTICE, EPIPOLAR).calibrated(np.eye(6), 0.0, np.array([total - 1.0]))
        for total in (645.0, 6450.0)
    )
    np.testing.assert_allclose(usual[:3, :3], 0.2 * np.eye(3))
    np.testing.assert_allclose(much[:3, :3], 0.2 * 10**-0.8 * np.eye(3))


def test_a_covariance_without_travel_stays_one(uncertainty):
    found = uncertainty.calibrated(without_travel(np.eye(6)), 0.0, np.array([644.0]))
    assert found[0, 0] == -1 and not found[:3, 3:].any()


def test_without_travel_only_the_rotation_s_part_is_left():
    covariance = without_travel(np.arange(36.0).reshape(6, 6))
    assert covariance[0, 0] == -1
    np.testing.assert_array_equal(covariance[3:, 3:], np.arange(36.0).reshape(6, 6)[3:, 3:])
    assert np.count_nonzero(covariance[:3]) == 1 and not covariance[3:, :3].any()
