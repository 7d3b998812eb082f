"""Estimates that the events do not carry are withheld."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.camera_motion import SplineMotion
from emoflow_ros.core.doubt import Doubt, ReliableOnly
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.gyro_checks import GyroFault, GyroState, GyroStatus
from emoflow_ros.core.gyro_measurement import GyroMeasurement
from emoflow_ros.core.lattice import Lattice, LatticeFlow
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.reading import with_gyro
from emoflow_ros.core.uncertainty import Disagreement

LATTICE = Lattice(20, 20, 2, 2, 2)
TRAVEL = SplineMotion(0, 100_000_000, np.ones((4, 3)), np.ones((4, 3)))
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

    def __init__(
        self, *doubts: float, status: Status = Status.OK, gyro: GyroStatus | None = None
    ) -> None:
        self._doubts = iter(doubts)
        self._status = status
        self._gyro = gyro or GyroStatus()
        self.resets = 0

    def reset(self) -> None:
        self.resets += 1

    def estimate(self, window: Window) -> Estimate:
        quality = Quality(events=7, doubt=next(self._doubts))
        flow = LatticeFlow(LATTICE, np.zeros(LATTICE.shape, np.float32), 0, 100)
        return Estimate(window.t_start, window.t_end, 50, self._status, quality, MotionModel.FULL,
                        np.ones(3), np.ones(3), np.eye(6), flow, TRAVEL, self._gyro)  # fmt: skip


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


def test_with_a_gyro_only_the_flow_is_withheld():
    estimator = ReliableOnly(Scripted(0.2, 0.9, gyro=GyroStatus(GyroState.USED)), 0.2)
    sure, unsure = (estimator.estimate(WINDOW) for _ in range(2))
    assert sure.flow is not None and unsure.flow is None
    assert unsure.status is Status.OK and unsure.translation_observable
    np.testing.assert_array_equal(unsure.angular, 1)
    np.testing.assert_array_equal(unsure.covariance, np.eye(6))


USED = GyroStatus(GyroState.USED)
END = 100_000_000
# w(s) = c0 + c1 (2s - 1) + c2 (6s^2 - 6s + 1): in the middle c0 - c2 / 2.
COEFFICIENTS = np.array([[0.5, -0.2, 0.1], [0.1, 0.0, -0.3], [0.02, 0.04, 0.0]])
COVARIANCES = np.stack([np.diag([4.0, 5.0, 6.0]), np.eye(3), 4 * np.eye(3)]) * 1e-4
MEASUREMENT = GyroMeasurement(0, END, COEFFICIENTS, COVARIANCES)


def estimate_of(doubt: float, gyro: GyroStatus = USED) -> Estimate:
    return Scripted(doubt, gyro=gyro).estimate(Window(0, END, Events.empty()))


@pytest.mark.parametrize(("doubt", "model", "travels"), [
    (0.2, "auto", True), (0.21, "auto", False), (0.21, "full", True),
])  # fmt: skip
def test_a_gyro_tells_w_and_a_flow_that_is_not_too_doubtful_v(doubt, model, travels):
    config = LatticeConfig(max_doubt=0.1, model=model)
    found = with_gyro(estimate_of(doubt), MEASUREMENT, config)
    assert found.status is Status.OK and found.translation_observable == travels
    np.testing.assert_allclose(found.angular, [0.49, -0.22, 0.1])
    np.testing.assert_allclose(found.covariance[3:, 3:], np.diag([5.0, 6.0, 7.0]) * 1e-4)
    np.testing.assert_array_equal(found.linear, float(travels))
    assert found.covariance[0, 0] == (1 if travels else -1)
    assert found.motion is not None
    for s in (0.0, 0.3, 0.5, 1.0):
        t = round(s * END)
        np.testing.assert_allclose(found.motion.angular(t), MEASUREMENT.at(s), atol=1e-9)
        np.testing.assert_allclose(found.motion.linear(t), travels * 3**-0.5)


def test_without_a_gyro_that_is_used_the_events_tell_w():
    config = LatticeConfig(max_doubt=0.1)
    refuted = estimate_of(0.3, GyroStatus(GyroState.REJECTED, GyroFault.DISAGREES))
    assert with_gyro(refuted, MEASUREMENT, config) is refuted
    alone = estimate_of(0.3)
    assert with_gyro(alone, None, config) is alone
    straight = LatticeConfig(max_doubt=0.1, model="translation")
    assert with_gyro(alone, MEASUREMENT, straight) is alone


@pytest.mark.parametrize("status", [Status.NO_MOTION, Status.TOO_FEW_EVENTS, Status.DIVERGED])
@pytest.mark.parametrize("model", ["auto", "full"])
def test_where_the_events_give_nothing_the_gyro_alone_tells_w(status, model):
    nothing = Estimate(0, END, END // 2, status, Quality(7, stop_reason=str(status)), gyro=USED)
    found = with_gyro(nothing, MEASUREMENT, LatticeConfig(model=model))
    assert (found.status, found.by_events) == (Status.OK, status)
    assert found.model is MotionModel.ROTATION and not found.translation_observable
    np.testing.assert_allclose(found.angular, [0.49, -0.22, 0.1])
    np.testing.assert_allclose(found.covariance[3:, 3:], np.diag([5.0, 6.0, 7.0]) * 1e-4)
    assert found.covariance[0, 0] == -1 and found.flow is None
    assert found.motion is not None
    np.testing.assert_allclose(found.motion.angular(END // 4), MEASUREMENT.at(0.25), atol=1e-9)
    np.testing.assert_array_equal(found.motion.linear(END // 4), 0)
    rejected = replace(nothing, gyro=GyroStatus(GyroState.REJECTED, GyroFault.DISAGREES))
    assert with_gyro(rejected, MEASUREMENT, LatticeConfig(model=model)) is rejected


def test_a_rejected_gyro_vouches_for_nothing():
    rejected = GyroStatus(GyroState.REJECTED, GyroFault.FROZEN)
    estimator = ReliableOnly(Scripted(0.9, gyro=rejected), 0.2)
    assert estimator.estimate(WINDOW).status is Status.UNCERTAIN


def test_other_verdicts_stay():
    inner = Scripted(0.9, status=Status.DIVERGED)
    assert ReliableOnly(inner, 0.2).estimate(WINDOW).status is Status.DIVERGED
