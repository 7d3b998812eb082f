"""Estimates that the events do not carry are withheld."""

import numpy as np
import pytest

from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Events
from emoflow_ros.core.reliability import ReliableOnly, probability_of_failure
from emoflow_ros.core.windows import Window

WINDOW = Window(0, 100, Events.empty())
EVENLY = np.full(100, 6.45)  # evidence on each node


FLOW = np.tile([3.0, 4.0], (100, 1))  # 5 px


def quality(events=20_000, inliers=0.9, gain=1.5, change=0.8) -> Quality:
    return Quality(events, inlier_fraction=inliers, contrast_gain=gain, change_px=change)


def test_the_regression_by_hand():
    score = (-5.346 - 1.300 * np.log(646) - 3.824 * 0.9 - 1.118 * np.log(1.0)
             + 1.445 * np.log(20_000) - 0.699 * np.log(0.52) + 0.985 * np.log(1.0)
             + 0.212 * np.log(0.1) + 0.505 * np.log(5.5)
             + 0.271 * np.log(np.radians(11.0)))  # fmt: skip
    found = probability_of_failure(EVENLY, FLOW, 0.1, np.radians(10.0), quality())
    assert found == pytest.approx(1 / (1 + np.exp(-score)), rel=1e-9)


def test_less_evidence_in_fewer_places_outliers_change_and_jumps_are_less_reliable():
    def doubt(evidence=EVENLY, jump=0.1, **kind) -> float:
        return probability_of_failure(evidence, FLOW, 0.1, jump, quality(**kind))

    usual = doubt()
    few_places = np.where(np.arange(100) < 10, 64.5, 0.0)
    assert doubt(few_places) > 2 * usual
    assert doubt(EVENLY / 4) > 2 * usual
    assert doubt(inliers=0.6) > 1.5 * usual
    assert doubt(events=60_000) > 1.5 * usual
    assert doubt(change=3.0) > 1.5 * usual
    assert doubt(jump=1.0) > 1.2 * usual
    assert 0 < probability_of_failure(0 * EVENLY, 0 * FLOW, 0.1, 0.0, quality(0, 0.0, 0.5)) <= 1


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
