"""The origin of the sensor's clock changes no estimate, of windows that are thinned as well."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.stream.bounded_windows import RateLimitedSlicer
from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

CONFIG = load_config("realtime", {"estimator.max_events": 6000})


@pytest.fixture(scope="module")
def recording() -> SimulatedRecording:
    return simulate("forward", duration_s=0.3, seed=0)


def estimates(recording: SimulatedRecording, shift: int) -> list[Estimate]:
    """Estimate the windows of a recording whose clock is ahead by so many ns."""
    slicer = RateLimitedSlicer(EventBudget(CONFIG.window, CONFIG.estimator.max_events))
    estimator = make_estimator(recording.camera, CONFIG)
    later = replace(recording.events, t=recording.events.t + shift)
    found = [estimator.estimate(window) for window in slicer.push(later)]
    assert slicer.left_out > 10_000
    return found


@pytest.fixture(scope="module")
def unshifted(recording: SimulatedRecording) -> list[Estimate]:
    return estimates(recording, 0)


@pytest.mark.parametrize("shift", [100_000, 23_000_000_007, 10**18])
def test_estimates_are_those_of_the_clock_of_another_origin(
    recording: SimulatedRecording, unshifted: list[Estimate], shift: int
) -> None:
    found = estimates(recording, shift)
    assert len(found) == len(unshifted) == 3
    assert all(estimate.status is Status.OK for estimate in unshifted)
    for one, other in zip(unshifted, found, strict=True):
        assert (other.status, other.t_start) == (one.status, one.t_start + shift)
        for name in ("angular", "linear", "covariance"):
            np.testing.assert_array_equal(getattr(other, name), getattr(one, name), name)
