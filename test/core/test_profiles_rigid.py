"""The profile `rigid` on a simulated static scene, whose truth is exact, beside `realtime`."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera_motion import motion_matrices
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import NS_PER_S, WindowSlicer
from emoflow_ros.factory import make_estimator
from emoflow_ros.simulation.recording import SimulatedRecording, simulate

START = 1_500_000_000_000_000_000


@dataclass(frozen=True)
class Runs:
    """A recording and the warm windows that each profile makes of it."""

    recording: SimulatedRecording
    rigid: list[Estimate]
    realtime: list[Estimate]


@pytest.fixture(scope="module")
def calm() -> Runs:
    recording = simulate("calm", duration_s=0.3, seed=1, fps=500, start_ns=START)
    return Runs(recording, *(warm_of(recording, name) for name in ("rigid", "realtime")))


def warm_of(recording: SimulatedRecording, profile: str) -> list[Estimate]:
    """The windows are the same for each, and a direction of translation is told in all of them."""
    told = load_config(profile, {"estimator.model": "full"})
    config = replace(told, window=load_config("rigid").window)
    estimator = make_estimator(recording.camera, config)
    windows = WindowSlicer(config.window).push(recording.events)
    _, *warm = [estimator.estimate(window) for window in windows]
    return warm


def across_epipolar_lines(recording: SimulatedRecording, estimate: Estimate) -> np.ndarray:
    """Flow (H, W) that no depth explains under the estimate's own motion, px over the window."""
    camera = recording.camera
    a, b = motion_matrices(camera.bearings.astype(np.float64))
    lens = np.linalg.inv(camera.flow_jacobian.astype(np.float64))
    seconds = (estimate.t_end - estimate.t_start) / NS_PER_S
    flow = estimate.flow.velocity(estimate.t).astype(np.float64)
    rest = flow - np.einsum("...ij,...jk,k->...i", lens, b, estimate.angular)
    line = np.einsum("...ij,...jk,k->...i", lens, a, estimate.linear)
    across = rest[..., 0] * line[..., 1] - rest[..., 1] * line[..., 0]
    return seconds * across / np.linalg.norm(line, axis=-1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def test_flow_of_warm_windows_is_within_a_pixel(calm):
    assert len(calm.rigid) == 2
    for estimate in calm.rigid:
        assert (estimate.status, estimate.model) == (Status.OK, MotionModel.FULL)
        assert estimate.quality.warm
        interval = estimate.t_start, estimate.t_end
        truth = calm.recording.truth.displacement(*interval)
        error = np.linalg.norm(estimate.flow.displacement(*interval) - truth, axis=-1)
        assert np.nanmean(np.linalg.norm(truth, axis=-1)) > 8  # 8.7 px
        assert np.nanmean(error) < 0.7  # 0.45 and 0.47 px


def test_flow_is_a_motion_field(calm):
    """At the nodes to a quarter of what `realtime` leaves; in between both interpolate.

    Across the lines of the reported motion, which is a mean over the possible ones, more is left.
    """
    left = [[e.quality.residual_px for e in run] for run in (calm.rigid, calm.realtime)]
    assert np.mean(left[0]) < 0.25 * np.mean(left[1])
    for rigid, realtime in zip(calm.rigid, calm.realtime, strict=True):
        assert 0 < rigid.quality.residual_px < 0.01 < 0.02 < realtime.quality.residual_px
        assert rms(across_epipolar_lines(calm.recording, rigid)) < 0.1
