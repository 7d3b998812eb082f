"""The optimiser with its learning rates, and when to stop."""

import math

import torch
from torch.optim.lr_scheduler import LambdaLR

from emoflow_ros.core.implicit.config import EarlyStopConfig, OptimizerConfig
from emoflow_ros.core.implicit.field import CoordinateMLP
from emoflow_ros.core.implicit.motion import MotionSpline

_ALGORITHMS = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}


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
