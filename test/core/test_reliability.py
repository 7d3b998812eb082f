"""Estimates that the events do not carry are withheld."""

import numpy as np
import pytest

from emoflow_ros.core.doubt import Doubt, ReliableOnly
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.uncertainty import Disagreement

WINDOW = Window(0, 100, Events.empty())


def apart(look: float, earlier: float = np.nan, moved: float = 8.0) -> Disagreement:
    return Disagreement(look, moved, earlier)


def doubt(look: float, earlier: float = np.nan, moved: float = 8.0) -> float:
    """Of a first window: as if half of those before were confirmed."""
    return Doubt().weigh(apart(look, earlier, moved))


def logistic(score: float) -> float:
    return 1 / (1 + np.exp(-score))


def test_the_regression_by_hand():
    assert doubt(1.0) == pytest.approx(logistic(-2.45 + 0.8 * np.log(1.1)), rel=1e-9)
    both = -1.1 + 0.9 * np.log(1.1) + 0.55 * np.log(0.6) - 0.8 * np.log(8.1)
    assert doubt(1.0, 0.5) == pytest.approx(logistic(both), rel=1e-9)


@pytest.mark.parametrize(("before", "confirmed"), [
    (apart(1.0, 1.5), True), (apart(1.0, 2.5), False), (apart(1.0, 2.5, 10.0), True),
    (apart(0.7), True), (apart(0.8), False),
])  # fmt: skip
def test_the_last_twenty_windows_count_by_whether_they_were_confirmed(before, confirmed):
    """Five more, half of them confirmed, count as well."""
    present = -0.1 + 0.9 * np.log(1.1) + 0.55 * np.log(0.6) - 0.8 * np.log(8.1)
    for earlier in (1, 4, 20, 50):
        judge = Doubt()
        for _ in range(earlier):
            judge.remember(before)
        known = min(earlier, 20)
        share = (2.5 + known * confirmed) / (5 + known)
        assert judge.weigh(apart(1.0, 0.5)) == pytest.approx(logistic(present - 2 * share))
    judge.forget()
    assert judge.weigh(apart(1.0, 0.5)) == doubt(1.0, 0.5)


def test_the_further_other_explanations_lie_the_less_reliable():
    doubts = [doubt(distance) for distance in (0.0, 0.5, 1.0, 2.0, 5.0, 1e6)]
    assert doubts == sorted(doubts)
    assert doubts[0] < 0.05 < 0.24 < doubts[-2] < doubts[-1] <= 1
    earlier = [doubt(1.0, distance) for distance in (0.0, 0.5, 1.0, 2.0, 5.0, 1e6)]
    assert earlier == sorted(earlier)
    assert earlier[0] < 0.02 < 0.14 < earlier[-2] < earlier[-1] <= 1


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
