"""Warp points along the flow: a neural ODE (method.md, section 2), solved by torchdiffeq."""

from typing import Any

import torch
from torch import Tensor, nn
from torchdiffeq import odeint, odeint_adjoint

from emoflow_ros.core.implicit.config import FIXED_SOLVERS, WarpConfig


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
