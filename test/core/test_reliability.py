"""Estimates that the events do not carry are withheld."""

import numpy as np
import pytest

from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.second_look import ReliableOnly, probability_of_failure
from emoflow_ros.core.uncertainty import Disagreement

WINDOW = Window(0, 100, Events.empty())


def doubt(look: float, earlier: float = np.nan, moved: float = 8.0) -> float:
    return probability_of_failure(Disagreement(look, moved, earlier))


def test_the_regression_by_hand():
    alone = -2.18 + 0.8 * np.log(1.1)
    assert doubt(1.0) == pytest.approx(1 / (1 + np.exp(-alone)), rel=1e-9)
    both = -1.34 + 0.9 * np.log(1.1) + 0.89 * np.log(0.6) - 0.86 * np.log(8.1)
    assert doubt(1.0, 0.5) == pytest.approx(1 / (1 + np.exp(-both)), rel=1e-9)


def test_the_further_other_explanations_lie_the_less_reliable():
    doubts = [doubt(distance) for distance in (0.0, 0.5, 1.0, 2.0, 5.0, 1e6)]
    assert doubts == sorted(doubts)
    assert doubts[0] < 0.05 < 0.25 < doubts[-2] < doubts[-1] <= 1
    earlier = [doubt(1.0, distance) for distance in (0.0, 0.5, 1.0, 2.0, 5.0, 1e6)]
    assert earlier == sorted(earlier)
    assert earlier[0] < 0.02 < 0.15 < earlier[-2] < earlier[-1] <= 1


def test_the_same_distance_counts_less_where_the_image_moves_more():
    assert doubt(1.0, 1.0, moved=20.0) < 0.5 * doubt(1.0, 1.0, moved=5.0)


class Scripted:
    """Gives the doubts in turn."""

    def __init__(self, *doubts: float, status: Status = Status.OK) -> None:
        self._doubts = iter(doubts)
        self._status = status
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def estimate(self, window: Window) -> Estimate:
        quality = Quality(events=7, doubt=next(self._doubts))
        return Estimate(window.t_start, window.t_end, 50, self._status, quality,
                        MotionModel.FULL, np.ones(3), np.ones(3), np.eye(6))  # fmt: skip


def test_only_what_is_reliable_goes_on():
    inner = Scripted(0.2, 0.21, float("nan"))
    estimator = ReliableOnly(inner, 0.2)
    sure, unsure, unknown = (estimator.estimate(WINDOW) for _ in range(3))
    assert (sure.status, unknown.status) == (Status.OK, Status.OK)
    assert unsure.status is Status.UNCERTAIN
    assert unsure.quality.doubt == 0.21 and unsure.quality.events == 7
    assert (unsure.t_start, unsure.t_end, unsure.t) == (0, 100, 50)
    assert unsure.flow is None and unsure.motion is None
    np.testing.assert_array_equal(unsure.angular, 0)
    assert unsure.covariance[0, 0] == -1 and not unsure.translation_observable
    estimator.reset()
    assert inner.resets == 1


def test_other_verdicts_stay():
    inner = Scripted(0.9, status=Status.DIVERGED)
    assert ReliableOnly(inner, 0.2).estimate(WINDOW).status is Status.DIVERGED
