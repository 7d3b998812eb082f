"""A fit whose values are lost: the estimator goes on as if it had just been made."""

from collections.abc import Callable

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.lattice.fit import LatticeFit
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.events import Window, WindowSlicer
from emoflow_ros.simulation.recording import simulate

CAMERA = Camera(120, 90, 110.0, 110.0, 60.0, 45.0)
CONFIG = load_config("realtime")


@pytest.fixture(scope="module")
def windows() -> list[Window]:
    recording = simulate("calm", duration_s=0.47, seed=5, camera=CAMERA, fps=250)
    return WindowSlicer(CONFIG.window).push(recording.events)


def lost_flow(fit: LatticeFit) -> None:
    fit.flow[:] = np.nan


def lost_motion(fit: LatticeFit) -> None:
    assert fit.motion is not None
    fit.motion.w[:] = np.nan


def assert_same_motion(estimate: Estimate, expected: Estimate) -> None:
    assert estimate.status is expected.status is Status.OK
    np.testing.assert_array_equal(estimate.angular, expected.angular)
    np.testing.assert_array_equal(estimate.linear, expected.linear)


@pytest.mark.parametrize("lose", [lost_flow, lost_motion])
def test_values_that_are_lost_cost_the_window_and_the_next_starts_cold(
    windows: list[Window], monkeypatch: pytest.MonkeyPatch, lose: Callable[[LatticeFit], None]
) -> None:
    estimator, untouched = (LatticeEstimator(CAMERA, CONFIG.estimator) for _ in range(2))
    assert [estimator.estimate(w).status for w in windows[:2]] == [Status.OK] * 2

    def step(fit: LatticeFit) -> None:
        step_coupled(fit)
        lose(fit)

    step_coupled = LatticeFit.step_coupled
    with monkeypatch.context() as patch:
        patch.setattr(LatticeFit, "step_coupled", step)
        patch.setattr(LatticeFit, "step_rotation", lambda fit: lose(fit))
        assert estimator.estimate(windows[2]).status is Status.DIVERGED

    again, fresh = estimator.estimate(windows[3]), untouched.estimate(windows[3])
    assert not again.quality.warm
    assert_same_motion(again, fresh)
    assert estimator.estimate(windows[4]).quality.warm
