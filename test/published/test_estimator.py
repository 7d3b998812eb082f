import dataclasses

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from emoflow_ros.core.geometry import camera_motion
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Status
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.errors import InputError
from emoflow_ros.published.assess import assess
from emoflow_ros.published.estimator import ImplicitEstimator
from emoflow_ros.published.field import MotionSpline
from emoflow_ros.published.fit import Fit, Problem
from emoflow_ros.published.implicit_config import (
    EarlyStopConfig,
    FieldConfig,
    ImplicitConfig,
    LossConfig,
    OptimizerConfig,
    WarpConfig,
)
from emoflow_ros.published.losses import PixelMaps

START = 1_500_000_000_000_000_000  # a realistic epoch, where float32 seconds would fail
DURATION = 100_000_000
VELOCITY = np.array([35.0, -20.0])

CONFIG = ImplicitConfig(
    max_events=3000,
    min_events=500,
    seed=3,
    field=FieldConfig(layers=3, width=32),
    loss=LossConfig(contrast_only=60),
    optimizer=OptimizerConfig(iterations=100, field_rate=3e-3, final_field_rate=1e-3),
)


def moving_dots(camera: Camera, velocity: np.ndarray, count: int = 150) -> Window:
    """Make the events of dots that move at a constant velocity, px/s, without noise."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, DURATION, 5000))
    size = np.array([camera.width, camera.height])
    dots = rng.uniform(-0.1, 1.1, (count, 2)) * size
    position = dots[rng.integers(0, count, len(t))] + t[:, None] * 1e-9 * velocity
    x, y = np.rint(position).T
    inside = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    events = Events(
        x[inside].astype(np.uint16),
        y[inside].astype(np.uint16),
        START + t[inside].astype(np.int64),
        np.ones(inside.sum(), np.bool_),
    )
    return Window(START, START + DURATION, events)


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Camera(80, 60, 70.0, 72.0, 39.0, 31.0)


@pytest.fixture(scope="module")
def window(camera: Camera) -> Window:
    return moving_dots(camera, VELOCITY)


@pytest.fixture(scope="module")
def estimate(camera: Camera, window: Window) -> Estimate:
    return ImplicitEstimator(camera, CONFIG).estimate(window)


def test_constant_flow_is_recovered(estimate: Estimate) -> None:
    assert estimate.status is Status.OK
    assert estimate.flow is not None
    inner = np.s_[5:-5, 5:-5]
    moved = estimate.flow.displacement(START, START + DURATION)[inner]
    error = np.linalg.norm(moved - VELOCITY * 0.1, axis=-1)
    assert error.mean() < 0.35
    flow = estimate.flow.velocity(START + DURATION // 2)[inner]
    assert np.linalg.norm(flow - VELOCITY, axis=-1).mean() < 6.0


def test_quality_tells_what_was_done(estimate: Estimate) -> None:
    quality = estimate.quality
    assert (quality.events, quality.iterations) == (3000, 100)
    assert quality.stop_reason == "iterations"
    assert quality.contrast_gain > 1.3
    assert not quality.warm
    assert (estimate.t_start, estimate.t_end) == (START, START + DURATION)
    assert estimate.t == START + DURATION // 2


def test_motion_holds_at_the_middle(estimate: Estimate) -> None:
    assert estimate.model is MotionModel.FULL
    assert estimate.motion is not None
    np.testing.assert_array_equal(estimate.linear, estimate.motion.linear(estimate.t))
    np.testing.assert_array_equal(estimate.angular, estimate.motion.angular(estimate.t))
    assert np.linalg.norm(estimate.linear) == pytest.approx(1)


def test_covariance_is_across_the_direction(estimate: Estimate) -> None:
    assert estimate.translation_observable
    covariance = estimate.covariance
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > -1e-12 * np.trace(covariance)
    assert (np.diag(covariance) > 0).all()
    # The direction turns little within the window.
    along = estimate.linear @ covariance[:3, :3] @ estimate.linear
    assert along < 1e-3 * np.trace(covariance[:3, :3])


def test_flow_products_agree_with_each_other(estimate: Estimate) -> None:
    flow = estimate.flow
    assert flow is not None
    end = START + DURATION
    points = np.array([[20.0, 30.0], [50.0, 41.0], [3.0, 3.0]])
    tracks = flow.tracks(points, [START, START + DURATION // 3, end])
    assert tracks.shape == (3, 3, 2)
    np.testing.assert_array_equal(tracks[0], points)
    part = flow.displacement(START, START + DURATION // 3)
    for point, track in zip(points, tracks[1], strict=True):
        column, row = point.astype(int)
        np.testing.assert_allclose(track, point + part[row, column], atol=1e-4)
    whole = flow.displacement(START, end)
    velocity = flow.velocity(START)  # one Euler step is the flow at the start
    np.testing.assert_allclose(whole, 0.1 * velocity, atol=1e-4)


def test_same_seed_gives_the_same_bits(camera: Camera, window: Window, estimate: Estimate) -> None:
    estimator = ImplicitEstimator(camera, CONFIG)
    torch.manual_seed(99)  # PyTorch's own generator must not matter
    for _ in range(2):  # neither must the windows before
        again = estimator.estimate(window)
        np.testing.assert_array_equal(again.angular, estimate.angular)
        np.testing.assert_array_equal(again.linear, estimate.linear)
        assert again.flow is not None
        assert estimate.flow is not None
        t = START + 1
        np.testing.assert_array_equal(again.flow.velocity(t), estimate.flow.velocity(t))
        assert again.quality.contrast_gain == estimate.quality.contrast_gain
    other = ImplicitEstimator(camera, dataclasses.replace(CONFIG, seed=4)).estimate(window)
    assert (other.angular != estimate.angular).any()


def test_rotation_geometry_publishes_no_translation(camera: Camera, window: Window) -> None:
    config = dataclasses.replace(
        CONFIG,
        loss=LossConfig(contrast_only=20, geometry="rotation"),
        optimizer=dataclasses.replace(CONFIG.optimizer, iterations=40),
    )
    estimate = ImplicitEstimator(camera, config).estimate(window)
    assert estimate.model is MotionModel.ROTATION
    assert not estimate.translation_observable
    np.testing.assert_array_equal(estimate.linear, np.zeros(3))
    assert estimate.covariance[0, 0] == -1
    assert not estimate.covariance[:3, 1:].any()
    assert np.linalg.eigvalsh(estimate.covariance[3:, 3:]).min() > 0


def test_stops_early_when_nothing_improves(camera: Camera, window: Window) -> None:
    never = EarlyStopConfig(burn_in=10, patience=5, min_improvement=1e6)
    config = dataclasses.replace(CONFIG, early_stop=never, loss=LossConfig(contrast_only=10))
    quality = ImplicitEstimator(camera, config).estimate(window).quality
    # The first watched loss is always an improvement; five more are none.
    assert (quality.iterations, quality.stop_reason) == (16, "converged")


def test_every_part_runs_together(camera: Camera, window: Window) -> None:
    config = ImplicitConfig(
        max_events=1000,
        field=FieldConfig(layers=2, width=16, octaves=2),
        warp=WarpConfig(solver="rk4", steps=3, gradient="adjoint"),
        loss=LossConfig(contrast_only=2, penalty="squares", smoothness_weight=0.15),
        optimizer=OptimizerConfig(iterations=5, algorithm="adamw", schedule="cosine", warmup=2),
        min_contrast_gain=0.0,
    )
    estimate = ImplicitEstimator(camera, config).estimate(window)
    assert estimate.status is Status.OK
    assert (estimate.angular != 0.2).all()


def test_too_few_events_give_a_status(camera: Camera, window: Window) -> None:
    few = dataclasses.replace(window, events=window.events[:499])
    estimate = ImplicitEstimator(camera, CONFIG).estimate(few)
    assert estimate.status is Status.TOO_FEW_EVENTS
    assert estimate.flow is None
    assert estimate.quality.events == 499


def test_events_beyond_the_sensor_do_not_count(camera: Camera, window: Window) -> None:
    shifted = dataclasses.replace(window.events, x=window.events.x + np.uint16(80))
    estimate = ImplicitEstimator(camera, CONFIG).estimate(
        dataclasses.replace(window, events=shifted)
    )
    assert estimate.status is Status.TOO_FEW_EVENTS
    assert estimate.quality.events == 0


def test_a_window_without_gain_is_one_without_motion(camera: Camera) -> None:
    still = moving_dots(camera, np.zeros(2))
    estimate = ImplicitEstimator(camera, CONFIG).estimate(still)
    assert estimate.status is Status.NO_MOTION
    assert estimate.quality.stop_reason == "no_motion"
    assert estimate.flow is None


def test_noise_alone_is_no_motion(camera: Camera) -> None:
    rng = np.random.default_rng(5)
    events = Events(
        rng.integers(0, camera.width, 3000).astype(np.uint16),
        rng.integers(0, camera.height, 3000).astype(np.uint16),
        START + np.sort(rng.integers(0, DURATION, 3000)),
        np.ones(3000, np.bool_),
    )
    estimate = ImplicitEstimator(camera, CONFIG).estimate(Window(START, START + DURATION, events))
    assert estimate.status is Status.NO_MOTION
    assert estimate.quality.contrast_gain == pytest.approx(1, abs=0.02)


def test_a_diverged_fit_is_named(camera: Camera, window: Window) -> None:
    rates = OptimizerConfig(iterations=20, field_rate=1e30, final_field_rate=1e30)
    config = dataclasses.replace(CONFIG, optimizer=rates)
    estimate = ImplicitEstimator(camera, config).estimate(window)
    assert estimate.status is Status.DIVERGED
    assert estimate.flow is None


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is here")
def test_missing_cuda_is_one_clear_error(camera: Camera) -> None:
    with pytest.raises(InputError, match="device: no CUDA device was found; use cpu"):
        ImplicitEstimator(camera, ImplicitConfig(device="cuda"))


class MotionField(nn.Module):
    """Exact flow of a scene at 2 m, in px/s, with bearings from a camera's maps."""

    def __init__(self, maps: PixelMaps, v: np.ndarray, w: np.ndarray) -> None:
        super().__init__()
        a, b = camera_motion.motion_matrices(maps.bearings.double().numpy())
        flow = torch.from_numpy(a @ v / 2 + b @ w).float()
        self.flow = torch.linalg.solve(maps.jacobian, flow)

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        column, row = x.long().unbind(-1)
        return self.flow[row, column]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_sign_of_v_comes_from_positive_depth(
    small_camera: Camera, window: Window, seed: int, sign: float
) -> None:
    rng = np.random.default_rng(seed)
    v, w = rng.normal(size=3), rng.normal(size=3)
    v /= np.linalg.norm(v)
    maps = PixelMaps.of(small_camera, "cpu")
    motion = MotionSpline(0.0)
    with torch.no_grad():
        motion.linear_points.copy_(torch.from_numpy(sign * v).expand(4, 3))
        motion.angular_points.copy_(torch.from_numpy(w).expand(4, 3))
    t = torch.from_numpy((window.events.t - START) * 1e-9).float()
    x = torch.from_numpy(np.stack([window.events.x, window.events.y], -1).astype(np.float32))
    fit = Fit(MotionField(maps, v, w), motion, 1, "iterations")
    config = dataclasses.replace(CONFIG, min_contrast_gain=0.0)
    found = assess(Problem(t, x, 0.1, maps), fit, 71.0, config)
    np.testing.assert_allclose(found.linear_points, np.tile(v, (4, 1)), atol=1e-6)
    assert found.residual_px < 1e-3


def test_a_motion_without_a_direction_is_diverged(camera: Camera, window: Window) -> None:
    optimizer = OptimizerConfig(iterations=1, motion_start=0.0, motion_rate=1e-12)
    estimate = ImplicitEstimator(camera, dataclasses.replace(CONFIG, optimizer=optimizer)).estimate(
        window
    )
    assert (estimate.status, estimate.flow) == (Status.DIVERGED, None)
    assert estimate.quality.stop_reason == "diverged"
    assert estimate.quality.iterations == 1
