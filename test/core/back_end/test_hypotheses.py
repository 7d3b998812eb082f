"""Ways that are possible: their weights, what is told of them, and that they are looked for."""

from dataclasses import replace

import numpy as np
import pytest
from small_problem import DEPTHS, NODES, PATCHES, T, V, W, prior, problem, truth

from emoflow_ros.core.back_end.adjustment import Adjusted, adjust
from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.evidence import Measured
from emoflow_ros.core.back_end.hypotheses import Hypotheses
from emoflow_ros.core.back_end.search import best, starts
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import along, interpolated

BACK = BackEndSettings()
MIDDLE = int(T[2])


@pytest.fixture(scope="module")
def found() -> Adjusted:
    return adjust(problem(), truth(), prior(), BACK.outlier, 5, DEPTHS)


def way(angular: np.ndarray, linear: np.ndarray) -> Unknowns:
    return along(T, np.tile(angular, (NODES, 1)), np.tile(linear, (NODES, 1)), np.ones(PATCHES))


def reversed_(x: Unknowns) -> Unknowns:
    return x._replace(position=-x.position, velocity=-x.velocity)


def pair(share: list[float]) -> Hypotheses:
    """Two ways: w and directions of translation differ."""
    ways = (way(W, np.array([0.2, 0.0, 0.0])), way(-W, np.array([0.0, 0.0, 0.7])))
    return Hypotheses(ways, np.array(share))


@pytest.mark.parametrize("misfit", [1.0, 4.0])
def test_a_way_that_costs_more_is_as_much_less_likely(found: Adjusted, misfit: float):
    expected = found.mean_cost(BACK)
    back = replace(BACK, expected_cost=BACK.expected_cost * expected / misfit)
    assert found.mean_cost(back) == pytest.approx(misfit)
    other = (reversed_(found.x), found.cost + 40.0)
    share = Hypotheses.weighed(found, [other], back).share
    assert share[1] / share[0] == pytest.approx(np.exp(-40.0 / (BACK.temperature * misfit)))
    assert share.sum() == pytest.approx(1)


def test_a_fit_that_is_too_good_does_not_decide_by_itself(found: Adjusted):
    back = replace(BACK, expected_cost=100.0)
    assert found.mean_cost(back) < 0.1
    share = Hypotheses.weighed(found, [(reversed_(found.x), found.cost + 12.0)], back).share
    assert share[1] / share[0] == pytest.approx(np.exp(-12.0 / (BACK.temperature * 0.6)))


def test_what_ends_in_the_same_direction_counts_once(found: Adjusted):
    near = found.x._replace(velocity=found.x.velocity + 0.05 * np.linalg.norm(V) * np.eye(3)[0])
    others = [(near, found.cost + 1.0), (reversed_(found.x), found.cost + 2.0)]
    others += [(reversed_(near), found.cost + 3.0)]
    hypotheses = Hypotheses.weighed(found, others, BACK)
    assert len(hypotheses.ways) == 2
    assert hypotheses.rival is not None
    rival, own = (x.velocity[-1] / np.linalg.norm(x.velocity[-1]) for x in hypotheses.ways)
    assert rival == pytest.approx(-own)


def test_a_camera_that_only_rotates_has_no_rival(found: Adjusted):
    rotating = replace(found, translates=False)
    hypotheses = Hypotheses.weighed(rotating, [(reversed_(found.x), found.cost)], BACK)
    assert len(hypotheses.ways) == 1 and hypotheses.rival is None
    assert hypotheses.share.tolist() == [1.0]


def test_ways_are_in_units_of_their_own_depth(found: Adjusted):
    near = found.x._replace(inverse_depth=1.5 * found.x.inverse_depth)
    scale = float(np.median(near.inverse_depth))
    other = reversed_(found.x)._replace(inverse_depth=0.7 * np.ones(PATCHES))
    hypotheses = Hypotheses.weighed(replace(found, x=near), [(other, found.cost)], BACK)
    assert hypotheses.ways[0].velocity == pytest.approx(scale * near.velocity)
    assert hypotheses.ways[1].velocity == pytest.approx(0.7 * other.velocity)
    assert [len(x.inverse_depth) for x in hypotheses.ways] == [0, 0]


def test_the_mean_is_by_their_shares():
    w, v, _ = interpolated(T, pair([0.75, 0.25]).mean, MIDDLE)
    assert w == pytest.approx(0.5 * W)
    direction = np.array([0.75, 0.0, 0.25])
    assert v == pytest.approx(0.2 * direction / np.linalg.norm(direction))  # the first one's speed


def test_the_mean_of_one_is_that_one():
    alone, (w, v, _) = pair([1.0, 0.0]), interpolated(T, pair([1.0, 0.0]).ways[0], MIDDLE)
    mean_w, mean_v, _ = interpolated(T, alone.mean, MIDDLE)
    assert mean_w == pytest.approx(w) and mean_v == pytest.approx(v)
    spread, of_direction = alone.spread(T, MIDDLE)
    assert spread == pytest.approx(np.zeros((3, 3)))
    assert of_direction == pytest.approx(np.zeros((3, 3)), abs=1e-9)


def test_the_spread_is_their_distance_from_the_mean():
    spread, of_direction = pair([0.5, 0.5]).spread(T, MIDDLE)
    assert spread == pytest.approx(np.outer(W, W))
    across = np.array([1.0, 0.0, -1.0]) / np.sqrt(2)  # both are 45 degrees off, to either side
    assert of_direction == pytest.approx((np.pi / 4) ** 2 * np.outer(across, across))


def test_they_go_on_node_by_node():
    longer = pair([0.5, 0.5]).carried_on(0.04)
    assert [len(x.position) for x in longer.ways] == [NODES + 1] * 2
    rival = longer.ways[1]
    assert rival.rotation[-2].T @ rival.velocity[-2] == pytest.approx([0, 0, 0.7])
    assert rival.velocity[-1] == pytest.approx(rival.velocity[-2])
    assert rival.position[-2] == pytest.approx(-0.04 * rival.velocity[-2], abs=1e-3)
    shorter = longer.without_node(0).ways
    assert [len(x.position) for x in shorter] == [NODES] * 2
    assert shorter[1].position.tolist() == rival.position[1:].tolist()


def test_the_rival_is_tried_again(found: Adjusted):
    rival = way(W, np.array([0.0, 0.3, 0.0]))
    measured = (Measured(int(T[0]), int(T[2]), W, np.eye(3), V),)
    back = replace(BACK, directions_at=())  # the memory is full
    alone, both = Hypotheses((found.x,), np.ones(1)), Hypotheses((found.x, rival), np.full(2, 0.5))
    assert len(starts(T, found.x, measured, alone, back)) == 1  # as measured
    tried = starts(T, found.x, measured, both, back)
    assert len(tried) == 2
    assert tried[1].velocity.tolist() == rival.velocity.tolist()
    assert tried[1].position.tolist() == rival.position.tolist()
    assert tried[1].inverse_depth.tolist() == [1.0] * PATCHES  # looked for anew


def test_at_first_and_now_and_then_all_directions_are_tried(found: Adjusted):
    before, now = Hypotheses((found.x,), np.ones(1)), replace(BACK, directions_at=(NODES,))
    tried = np.array([x.velocity[0] for x in starts(T, found.x, (), before, now)])
    assert len(tried) == 18
    assert np.linalg.norm(tried, axis=1) == pytest.approx(BACK.start_speed)
    cosines = tried @ tried.T / BACK.start_speed**2 - 2 * np.eye(18)
    assert cosines.max() < np.cos(np.radians(30))
    never = replace(BACK, directions_at=())
    assert starts(T, found.x, (), before, never) == []
    assert len(starts(T, found.x, (), None, never)) == 18


def test_where_guesses_led_to_is_told():
    x = truth()
    result = best(problem(), x, prior(), [reversed_(x)], BACK)
    assert result is not None
    found, led = result
    assert len(led) == 1 and led[0][1] > found.cost
    assert found.x.angular[2] == pytest.approx(W, abs=0.02)


def test_a_start_that_a_guess_beats_is_a_guess_itself():
    x = truth()
    result = best(problem(), reversed_(x), prior(), [x], replace(BACK, steps=1))
    assert result is not None
    found, led = result
    assert len(led) == 1 and led[0][1] > found.cost
    assert led[0][0].velocity[-1] @ V < 0 < found.x.velocity[-1] @ V
