"""Options of the implicit estimator. The defaults are the paper's for MVSEC."""

import dataclasses
from dataclasses import dataclass

from emoflow_ros.core.types.options import option
from emoflow_ros.errors import InputError

FIXED_SOLVERS = ("euler", "midpoint", "rk4")
ADAPTIVE_SOLVERS = ("dopri5",)


@dataclass(frozen=True)
class FieldConfig:
    """The coordinate network (t, x, y) -> (u, v).

    Raises:
        InputError: positional encoding of coordinates that are not normalised.
    """

    layers: int = option(8, "hidden layers", minimum=1, maximum=64)
    width: int = option(256, "units of a hidden layer", minimum=1, maximum=4096)
    octaves: int = option(
        0,
        "octaves of positional encoding; 0 feeds the coordinates themselves",
        minimum=0,
        maximum=16,
    )
    normalised: bool = option(
        True,
        "feed coordinates in [-1, 1] and scale the output; false feeds raw pixels and seconds, "
        "as the published code does, and converges an order of magnitude more slowly",
    )
    output_scale: float = option(
        100.0, "flow of a network output of 1 when normalised", unit="px/s", minimum=1e-3
    )

    def __post_init__(self) -> None:
        if self.octaves and not self.normalised:
            raise InputError(
                "field.octaves",
                f"{self.octaves} octaves of coordinates that are not in [-1, 1]",
                "set field.normalised to true, or field.octaves to 0",
            )


@dataclass(frozen=True)
class WarpConfig:
    """The neural ODE that moves events along the flow, and how it is differentiated.

    Raises:
        InputError: a solver that would ignore `steps`, or lacks them.
    """

    solver: str = option("euler", "ODE solver", choices=FIXED_SOLVERS + ADAPTIVE_SOLVERS)
    steps: int = option(
        1,
        "steps of a fixed-step solver from an event to the reference time; 0 for dopri5",
        minimum=0,
        maximum=10_000,
    )
    rtol: float = option(1e-4, "relative tolerance of dopri5", minimum=1e-14, maximum=1.0)
    atol: float = option(1e-3, "absolute tolerance of dopri5", unit="px", minimum=1e-14)
    gradient: str = option(
        "backprop",
        "backprop is exact for the discrete solution; adjoint needs memory for one step only, "
        "and steps that are small enough to integrate back",
        choices=("backprop", "adjoint"),
    )

    def __post_init__(self) -> None:
        if self.solver not in FIXED_SOLVERS + ADAPTIVE_SOLVERS:
            raise InputError(
                "warp.solver",
                f"unknown solver '{self.solver}'",
                f"use one of {', '.join(FIXED_SOLVERS + ADAPTIVE_SOLVERS)}",
            )
        if self.solver in FIXED_SOLVERS and self.steps < 1:
            raise InputError(
                "warp.steps", f"{self.steps} steps of {self.solver}", "give at least 1"
            )
        if self.solver in ADAPTIVE_SOLVERS and self.steps != 0:
            raise InputError(
                "warp.steps",
                f"{self.solver} would ignore {self.steps} steps",
                "set warp.steps to 0, and the accuracy by warp.rtol and warp.atol",
            )


@dataclass(frozen=True)
class LossConfig:
    """What is minimised: weights and phases."""

    contrast: str = option(
        "both",
        "sharpness of the image of warped events: mean Sobel magnitude, variance or their sum",
        choices=("gradient", "variance", "both"),
    )
    contrast_only: int = option(
        200, "first iterations, with the contrast (and smoothness) alone", minimum=0
    )
    geometry: str = option(
        "dec",
        "differential epipolar constraint, or a pure rotation, for which the former degenerates",
        choices=("dec", "rotation"),
    )
    geometry_weight: float = option(
        2.5, "weight of the geometric loss; 0 leaves it out", minimum=0.0
    )
    penalty: str = option("huber", "penalty of DEC residuals", choices=("huber", "squares"))
    huber_delta: float = option(
        0.1, "residual from which Huber's penalty is linear", unit="1/s", minimum=1e-9
    )
    smoothness_weight: float = option(0.0, "weight of the flow's total variation", minimum=0.0)


@dataclass(frozen=True)
class OptimizerConfig:
    """The optimiser and its learning rates."""

    iterations: int = option(1000, "steps per window", minimum=1, maximum=1_000_000)
    algorithm: str = option("adam", "optimiser", choices=("adam", "adamw"))
    schedule: str = option(
        "exponential",
        "of the field's learning rate: exponential decay, or warm-up and a cosine",
        choices=("exponential", "cosine"),
    )
    field_rate: float = option(1e-4, "learning rate of the field", minimum=1e-12)
    final_field_rate: float = option(
        6.3e-5, "learning rate of the field after the last step", minimum=1e-12
    )
    warmup: int = option(0, "steps of linear warm-up before the cosine", minimum=0)
    motion_rate: float = option(1e-3, "learning rate of the control points", minimum=1e-12)
    motion_start: float = option(0.2, "what every control point starts from", unit="rad/s")


@dataclass(frozen=True)
class EarlyStopConfig:
    """When to stop before all iterations are done."""

    burn_in: int = option(300, "iterations that are always done", minimum=0)
    patience: int = option(
        0, "iterations without improvement before stopping; 0 never stops early", minimum=0
    )
    min_improvement: float = option(
        1e-3, "fall of the loss below its best that counts as improvement", minimum=0.0
    )


@dataclass(frozen=True)
class ImplicitConfig:
    """How the implicit estimator fits a window (docs/method.md).

    Raises:
        InputError: early stopping that would compare losses of different phases.
    """

    max_events: int = option(
        30_000, "events used per window, drawn at random", minimum=1, maximum=10_000_000
    )
    min_events: int = option(1000, "with fewer events in a window nothing is estimated", minimum=1)
    min_contrast_gain: float = option(
        1.08, "with less contrast gain the window counts as one without motion", minimum=0.0
    )
    seed: int = option(0, "seed of weights, events and reference times", minimum=0)
    device: str = option("cpu", "where the fit runs", choices=("cpu", "cuda"))
    field: FieldConfig = dataclasses.field(default_factory=FieldConfig)
    warp: WarpConfig = dataclasses.field(default_factory=WarpConfig)
    loss: LossConfig = dataclasses.field(default_factory=LossConfig)
    optimizer: OptimizerConfig = dataclasses.field(default_factory=OptimizerConfig)
    early_stop: EarlyStopConfig = dataclasses.field(default_factory=EarlyStopConfig)

    def __post_init__(self) -> None:
        if self.early_stop.patience and self.early_stop.burn_in < self.loss.contrast_only:
            raise InputError(
                "early_stop.burn_in",
                f"{self.early_stop.burn_in} iterations end before the contrast-only phase of "
                f"{self.loss.contrast_only}, after which the loss rises",
                "give at least loss.contrast_only",
            )
