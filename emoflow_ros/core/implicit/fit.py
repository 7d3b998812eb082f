"""The optimisation loop over one window."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from emoflow_ros.core.implicit import losses
from emoflow_ros.core.implicit.config import ImplicitConfig
from emoflow_ros.core.implicit.field import CoordinateMLP
from emoflow_ros.core.implicit.motion import MotionSpline
from emoflow_ros.core.implicit.schedule import EarlyStopping, make_optimizer
from emoflow_ros.core.implicit.warp import warp
from emoflow_ros.core.spline import basis


@dataclass(frozen=True)
class Fit:
    """Result of the loop: the trained modules, and how it ended (see estimate.Quality)."""

    field: CoordinateMLP
    motion: MotionSpline
    iterations: int
    stop_reason: str


@dataclass(frozen=True)
class Problem:
    """One window on the device.

    Attributes:
        t: (N,) event times since the window's start, s.
        x: (N, 2) event positions, px.
        duration: the window's length, s.
        maps: the camera's maps, which tell the sensor's size, too.
    """

    t: Tensor
    x: Tensor
    duration: float
    maps: losses.PixelMaps


def fit(problem: Problem, config: ImplicitConfig) -> Fit:
    """Fit field and motion to a window from a cold, seeded start."""
    generator = torch.Generator().manual_seed(config.seed)
    height, width = problem.maps.valid.shape
    field = CoordinateMLP(config.field, width, height, problem.duration, generator)
    field.to(config.device)
    motion = MotionSpline(config.optimizer.motion_start).to(config.device)
    optimizer, schedule = make_optimizer(field, motion, config.optimizer)
    stopping = EarlyStopping(config.early_stop)
    references = _reference_times(problem.duration, config, generator)
    for iteration, (t_ref, weights) in enumerate(references):
        optimizer.zero_grad()
        loss = _loss(problem, field, motion, t_ref, weights, iteration, config)
        loss.backward()
        optimizer.step()
        schedule.step()
        if stopping.watches(iteration) and stopping.should_stop(loss.item()):
            return Fit(field, motion, iteration + 1, "converged")
    return Fit(field, motion, config.optimizer.iterations, "iterations")


def _reference_times(
    duration: float, config: ImplicitConfig, generator: torch.Generator
) -> Iterator[tuple[Tensor, Tensor]]:
    """Draw a reference time () for every iteration, with the spline's basis (4,) there.

    All are drawn and copied to the device at once. That no instant is the only one where
    events must align is what makes the flow continuous in time.
    """
    positions = torch.rand(config.optimizer.iterations, generator=generator)
    weights = torch.from_numpy(basis(positions.numpy()).astype(np.float32))
    times = (duration * positions).to(config.device)
    return zip(times, weights.to(config.device), strict=True)


def _loss(
    problem: Problem,
    field: CoordinateMLP,
    motion: MotionSpline,
    t_ref: Tensor,
    weights: Tensor,
    iteration: int,
    config: ImplicitConfig,
) -> Tensor:
    """Evaluate the loss of the phase that the iteration lies in."""
    height, width = problem.maps.valid.shape
    warped = warp(field, problem.t, problem.x, t_ref, config.warp)
    image = losses.blur(losses.vote(warped, height, width))
    loss = -losses.contrast(image, config.loss.contrast)
    if config.loss.smoothness_weight:
        variation = losses.smoothness_loss(field, t_ref, height, width, problem.duration)
        loss = loss + config.loss.smoothness_weight * variation
    if config.loss.geometry_weight and iteration >= config.loss.contrast_only:
        geometric = _geometric_loss(problem.maps, field, motion, t_ref, weights, warped, config)
        loss = loss + config.loss.geometry_weight * geometric
    return loss


def _geometric_loss(
    maps: losses.PixelMaps,
    field: CoordinateMLP,
    motion: MotionSpline,
    t_ref: Tensor,
    weights: Tensor,
    warped: Tensor,
    config: ImplicitConfig,
) -> Tensor:
    """Compare flow and motion at t_ref, at the pixels that hold warped events."""
    pixels = losses.occupied_pixels(warped, maps.valid)
    flow = field(t_ref.expand(len(pixels)), pixels.to(warped.dtype))
    bearings, flow = maps.normalised(pixels, flow)
    v, w = motion(weights)
    if config.loss.geometry == "rotation":
        return losses.rotation_loss(bearings, flow, w)
    residual = losses.dec_residual(bearings, flow, v, w)
    return losses.dec_loss(residual, config.loss.penalty, config.loss.huber_delta)
