"""The optimisation loop over one window, with its learning rates and when it stops."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.optim.lr_scheduler import LambdaLR

from emoflow_ros.core.geometry.camera_motion import basis
from emoflow_ros.published import losses
from emoflow_ros.published.field import CoordinateMLP, MotionSpline, warp
from emoflow_ros.published.implicit_config import (
    EarlyStopConfig,
    ImplicitConfig,
    OptimizerConfig,
)

_ALGORITHMS = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}


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


def field_rate(step: int, config: OptimizerConfig) -> float:
    """Give the field's learning rate at a step counted from 0.

    `exponential` falls from field_rate to final_field_rate at the last step; `cosine` first
    rises linearly over the warm-up, then falls along half a period.
    """
    first, last = config.field_rate, config.final_field_rate
    if config.schedule == "exponential":
        return float(first * (last / first) ** (step / max(1, config.iterations - 1)))
    if step < config.warmup:
        return first * (step + 1) / config.warmup
    progress = (step - config.warmup) / max(1, config.iterations - 1 - config.warmup)
    return last + (first - last) * (1 + math.cos(math.pi * progress)) / 2


def make_optimizer(
    field: CoordinateMLP, motion: MotionSpline, config: OptimizerConfig
) -> tuple[torch.optim.Optimizer, LambdaLR]:
    """Set up the optimiser of field and motion; the motion's learning rate is constant."""
    groups = [
        {"params": list(field.parameters()), "lr": 1.0},  # the schedule gives the rate itself
        {"params": list(motion.parameters()), "lr": config.motion_rate},
    ]
    optimizer = _ALGORITHMS[config.algorithm](groups)
    schedule = LambdaLR(optimizer, [lambda step: field_rate(step, config), lambda _step: 1.0])
    return optimizer, schedule


class EarlyStopping:
    """Stop when the loss has not improved for `patience` iterations after the burn-in."""

    def __init__(self, config: EarlyStopConfig) -> None:
        self._config = config
        self._best = math.inf
        self._since = 0

    def watches(self, iteration: int) -> bool:
        """Tell whether the loss of this iteration (from 0) is wanted: reading it costs a sync."""
        return self._config.patience > 0 and iteration >= self._config.burn_in

    def should_stop(self, loss: float) -> bool:
        """Take the loss of the next watched iteration and tell whether to stop after it."""
        if loss < self._best - self._config.min_improvement:
            self._best = loss
            self._since = 0
        else:
            self._since += 1
        return self._since >= self._config.patience
