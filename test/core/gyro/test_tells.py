"""What a gyro and the events tell together of a window."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.geometry.camera_motion import SplineMotion
from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.lattice.reading import with_gyro
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.gyro import GyroFault, GyroState, GyroStatus

LATTICE = Lattice(20, 20, 2, 2, 2)
TRAVEL = SplineMotion(0, 100_000_000, np.ones((4, 3)), np.ones((4, 3)))

USED = GyroStatus(GyroState.USED)
END = 100_000_000
# w(s) = c0 + c1 (2s - 1) + c2 (6s^2 - 6s + 1): in the middle c0 - c2 / 2.
COEFFICIENTS = np.array([[0.5, -0.2, 0.1], [0.1, 0.0, -0.3], [0.02, 0.04, 0.0]])
COVARIANCES = np.stack([np.diag([4.0, 5.0, 6.0]), np.eye(3), 4 * np.eye(3)]) * 1e-4
MEASUREMENT = GyroMeasurement(0, END, COEFFICIENTS, COVARIANCES)


def estimate_of(gyro: GyroStatus = USED) -> Estimate:
    flow = LatticeFlow(LATTICE, np.zeros(LATTICE.shape, np.float32), 0, END)
    return Estimate(0, END, END // 2, Status.OK, Quality(7), MotionModel.FULL, np.ones(3),
                    np.ones(3), np.eye(6), flow, TRAVEL, gyro)  # fmt: skip


@pytest.mark.parametrize("model", ["auto", "full"])
def test_a_gyro_tells_w_and_the_events_v_and_the_flow(model):
    found = with_gyro(estimate_of(), MEASUREMENT, LatticeConfig(model=model))
    assert found.status is Status.OK and found.translation_observable and found.flow is not None
    np.testing.assert_allclose(found.angular, [0.49, -0.22, 0.1])
    np.testing.assert_allclose(found.covariance[3:, 3:], np.diag([5.0, 6.0, 7.0]) * 1e-4)
    np.testing.assert_array_equal(found.linear, 1.0)
    assert found.covariance[0, 0] == 1
    assert found.motion is not None
    for s in (0.0, 0.3, 0.5, 1.0):
        t = round(s * END)
        np.testing.assert_allclose(found.motion.angular(t), MEASUREMENT.at(s), atol=1e-9)
        np.testing.assert_allclose(found.motion.linear(t), 3**-0.5)


def test_without_a_gyro_that_is_used_the_events_tell_w():
    config = LatticeConfig()
    refuted = estimate_of(GyroStatus(GyroState.REJECTED, GyroFault.DISAGREES))
    assert with_gyro(refuted, MEASUREMENT, config) is refuted
    alone = estimate_of()
    assert with_gyro(alone, None, config) is alone
    straight = LatticeConfig(model="translation")
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
