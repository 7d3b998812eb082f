"""What autograd optimises: the flow field as a network, the warp along it, and the egomotion."""

import math
from typing import Any

import torch
from torch import Tensor, nn
from torchdiffeq import odeint, odeint_adjoint

from emoflow_ros.core.geometry.camera_motion import CONTROL_POINTS
from emoflow_ros.published.implicit_config import FIXED_SOLVERS, FieldConfig, WarpConfig


class CoordinateMLP(nn.Module):
    """Map time and position to flow by a ReLU network with residual layers.

    The (encoded) input enters again halfway, into layer 5 of 8 (docs/published_method.md).

    Args:
        config: the network's size and encoding.
        width, height: sensor size in pixels.
        duration: the window's length in seconds.
        generator: source of the initial weights, on the CPU.
    """

    centre: Tensor
    scale: Tensor
    octaves: Tensor

    def __init__(
        self,
        config: FieldConfig,
        width: int,
        height: int,
        duration: float,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        inputs = 3 * (1 + 2 * config.octaves)
        self.skip = config.layers // 2
        sizes = [inputs] + [config.width] * (config.layers - 1)
        if self.skip:
            sizes[self.skip] += inputs
        self.hidden = nn.ModuleList(_linear(n, config.width, generator) for n in sizes)
        self.output = _linear(config.width, 2, generator)
        half = torch.tensor([duration, width - 1, height - 1]) / 2
        if config.normalised:
            centre, scale, self.output_scale = half, 1 / half, config.output_scale
        else:
            centre, scale, self.output_scale = torch.zeros(3), torch.ones(3), 1.0
        self.register_buffer("centre", centre)
        self.register_buffer("scale", scale)
        self.register_buffer("octaves", math.pi * 2.0 ** torch.arange(config.octaves))

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        """Evaluate the flow.

        Args:
            t: (N,) seconds since the window's start.
            x: (N, 2) pixels, column and row.

        Returns:
            (N, 2) px/s, u right and v down.
        """
        inputs = self.encode(torch.cat([t[:, None], x], dim=1))
        h = torch.relu(self.hidden[0](inputs))
        for i, layer in enumerate(self.hidden[1:], start=1):
            h = h + torch.relu(layer(torch.cat([h, inputs], dim=1) if i == self.skip else h))
        return self.output(h) * self.output_scale

    def encode(self, coordinates: Tensor) -> Tensor:
        """Scale coordinates (N, 3) of time and pixel, and append their sines and cosines."""
        coordinates = (coordinates - self.centre) * self.scale
        phases = (coordinates[:, :, None] * self.octaves).flatten(1)
        return torch.cat([coordinates, phases.sin(), phases.cos()], dim=1)


def _linear(inputs: int, outputs: int, generator: torch.Generator) -> nn.Linear:
    """Make a layer with PyTorch's usual initial weights, from a generator of our own."""
    layer: nn.Linear = nn.utils.skip_init(nn.Linear, inputs, outputs)
    bound = inputs**-0.5
    for parameter in layer.parameters():
        nn.init.uniform_(parameter, -bound, bound, generator=generator)
    return layer


class _AlongIntervals(nn.Module):
    """The flow with every point's own interval [t_k, t_ref] mapped to tau in [0, 1].

    With s = t_k + tau (t_ref - t_k), dx/ds = u(s, x) becomes
    dx/dtau = (t_ref - t_k) u(s, x), so that one solve serves all points.
    """

    def __init__(self, field: nn.Module, start: Tensor, span: Tensor) -> None:
        super().__init__()
        self.field = field
        self.start = start
        self.span = span

    def forward(self, tau: Tensor, x: Tensor) -> Tensor:
        return self.span[:, None] * self.field(self.start + tau * self.span, x)


def warp(field: nn.Module, t: Tensor, x: Tensor, t_ref: Tensor, config: WarpConfig) -> Tensor:
    """Integrate dx/ds = u(s, x(s)) from every point's time to the reference time.

    Args:
        field: maps (N,) seconds and (N, 2) pixels to (N, 2) px/s.
        t: (N,) times of the points, s.
        x: (N, 2) positions at those times, px.
        t_ref: () or (N,) time to warp to, s; earlier than t integrates backwards.
        config: solver, steps and kind of gradient.

    Returns:
        (N, 2) positions at t_ref, px. Differentiable in the field's parameters and in x.
    """
    solve = odeint_adjoint if config.gradient == "adjoint" else odeint
    ends = torch.tensor([0.0, 1.0], dtype=x.dtype, device=x.device)
    path = solve(
        _AlongIntervals(field, t, t_ref - t),
        x,
        ends,
        method=config.solver,
        rtol=config.rtol,
        atol=config.atol,
        options=_solver_options(config),
    )
    return path[-1]


def _solver_options(config: WarpConfig) -> dict[str, Any]:
    """Give the fixed-step solvers their grid; step_size would round to a step more or less."""
    if config.solver not in FIXED_SOLVERS:
        return {}

    def grid(_func: nn.Module, _x: Tensor, ends: Tensor) -> Tensor:
        tau = torch.linspace(0, 1, config.steps + 1, dtype=ends.dtype, device=ends.device)
        return ends[0] + tau * (ends[-1] - ends[0])

    return {"grid_constructor": grid}


class MotionSpline(nn.Module):
    """Control points of the window's angular and linear velocity (core/geometry/camera_motion.py).

    Args:
        start: what all control points start from.
    """

    def __init__(self, start: float) -> None:
        super().__init__()
        self.angular_points = nn.Parameter(torch.full((CONTROL_POINTS, 3), start))
        self.linear_points = nn.Parameter(torch.full((CONTROL_POINTS, 3), start))

    def forward(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the splines.

        Args:
            weights: (4,) basis at one time, from `core.geometry.camera_motion.basis`.

        Returns:
            Linear velocity as a unit direction (3,) and angular velocity (3,) in rad/s.
        """
        linear = nn.functional.normalize(weights @ self.linear_points, dim=0)
        return linear, weights @ self.angular_points
