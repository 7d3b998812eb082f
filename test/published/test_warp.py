import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from emoflow_ros.core.types.options import replace_options
from emoflow_ros.errors import InputError
from emoflow_ros.published.field import CoordinateMLP, warp
from emoflow_ros.published.implicit_config import FieldConfig, WarpConfig

CENTRE = torch.tensor([40.0, 30.0], dtype=torch.float64)


class Rotation(nn.Module):
    """Flow of a rotation about CENTRE at the rate a + b t, whose paths are known."""

    def __init__(self, a: float = 3.0, b: float = 20.0) -> None:
        super().__init__()
        self.rates = nn.Parameter(torch.tensor([a, b], dtype=torch.float64))
        self.calls = 0

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        self.calls += 1
        rate = self.rates[0] + self.rates[1] * t
        across = x - CENTRE
        return rate[:, None] * torch.stack([-across[:, 1], across[:, 0]], dim=-1)

    def path(self, t: Tensor, x: Tensor, t_ref: Tensor) -> Tensor:
        angle = self.rates[0] * (t_ref - t) + self.rates[1] * (t_ref**2 - t**2) / 2
        across = x - CENTRE
        return CENTRE + torch.stack(
            [
                angle.cos() * across[:, 0] - angle.sin() * across[:, 1],
                angle.sin() * across[:, 0] + angle.cos() * across[:, 1],
            ],
            dim=-1,
        )


def points(count: int = 50) -> tuple[Tensor, Tensor, Tensor]:
    """Times in [0, 0.2] s, positions, and a reference time with points on both sides."""
    generator = torch.Generator().manual_seed(1)
    t = 0.2 * torch.rand(count, generator=generator, dtype=torch.float64)
    x = torch.rand(count, 2, generator=generator, dtype=torch.float64) * 2 * CENTRE
    return t, x, torch.tensor(0.13, dtype=torch.float64)


@pytest.mark.parametrize(("solver", "order"), [("euler", 1), ("midpoint", 2), ("rk4", 4)])
def test_error_falls_with_the_order_of_the_solver(solver: str, order: int) -> None:
    field = Rotation()
    t, x, t_ref = points()

    def error(steps: int) -> float:
        moved = warp(field, t, x, t_ref, WarpConfig(solver=solver, steps=steps))
        return (moved - field.path(t, x, t_ref)).norm(dim=-1).mean().item()

    for steps in (8, 16, 32):
        assert error(steps) / error(2 * steps) == pytest.approx(2**order, rel=0.1)


@pytest.mark.parametrize(("solver", "stages"), [("euler", 1), ("midpoint", 2), ("rk4", 4)])
@pytest.mark.parametrize("steps", [1, 3, 7, 49])
def test_solver_takes_exactly_the_steps_asked_for(solver: str, stages: int, steps: int) -> None:
    field = Rotation()
    warp(field, *points(), WarpConfig(solver=solver, steps=steps))
    assert field.calls == steps * stages


def test_one_euler_step_is_the_flow_times_the_interval() -> None:
    field = Rotation()
    t, x, t_ref = points()
    moved = warp(field, t, x, t_ref, WarpConfig(solver="euler", steps=1))
    torch.testing.assert_close(moved, x + (t_ref - t)[:, None] * field(t, x))


def test_adaptive_solver_keeps_its_tolerance() -> None:
    field = Rotation()
    t, x, t_ref = points()
    config = WarpConfig(solver="dopri5", steps=0, rtol=1e-8, atol=1e-8)
    moved = warp(field, t, x, t_ref, config)
    torch.testing.assert_close(moved, field.path(t, x, t_ref), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    "config",
    [
        WarpConfig(solver="euler", steps=5000),
        WarpConfig(solver="midpoint", steps=200),
        WarpConfig(solver="rk4", steps=16),
        WarpConfig(solver="dopri5", steps=0, rtol=1e-9, atol=1e-9),
    ],
    ids=lambda config: config.solver,
)
def test_forward_then_back_is_the_identity(config: WarpConfig) -> None:
    field = Rotation()
    t, x, t_ref = points(20)
    with torch.no_grad():
        there = warp(field, t, x, t_ref, config)
        back = warp(field, t_ref.expand(len(t)), there, t, config)
    assert (there - x).norm(dim=-1).max() > 5
    tolerance = 2e-2 if config.solver == "euler" else 1e-3
    torch.testing.assert_close(back, x, atol=tolerance, rtol=0)


def test_points_at_the_reference_time_stay() -> None:
    t, x, _ = points()
    moved = warp(Rotation(), t, x, t, WarpConfig(solver="rk4", steps=2))
    torch.testing.assert_close(moved, x)


def gradients(
    field: nn.Module, x: Tensor, config: WarpConfig, t: Tensor, t_ref: Tensor
) -> tuple[Tensor, ...]:
    weights = torch.linspace(-1, 1, x.numel(), dtype=x.dtype).view_as(x)
    loss = (weights * warp(field, t, x, t_ref, config)).sum()
    return torch.autograd.grad(loss, [x, *field.parameters()])


def test_backprop_and_adjoint_agree_with_the_closed_form() -> None:
    field = Rotation()
    t, x, t_ref = points()
    x.requires_grad_()
    weights = torch.linspace(-1, 1, x.numel(), dtype=x.dtype).view_as(x)
    expected = torch.autograd.grad(
        (weights * field.path(t, x, t_ref)).sum(), [x, *field.parameters()]
    )
    for mode in ("backprop", "adjoint"):
        config = WarpConfig(solver="rk4", steps=40, gradient=mode)
        found = gradients(field, x, config, t, t_ref)
        torch.testing.assert_close(found, expected, rtol=1e-6, atol=1e-6)


def network() -> CoordinateMLP:
    generator = torch.Generator().manual_seed(2)
    return CoordinateMLP(FieldConfig(layers=3, width=16), 80, 60, 0.2, generator).double()


def along(function: Callable[[], Tensor], parameter: Tensor, direction: Tensor) -> float:
    """Central difference of a function along a direction of a parameter."""
    step = 1e-7  # short enough to cross hardly any kink of ReLU
    with torch.no_grad():
        parameter += step * direction
        above = function().item()
        parameter -= 2 * step * direction
        below = function().item()
        parameter += step * direction
    return (above - below) / (2 * step)


@pytest.mark.parametrize("mode", ["backprop", "adjoint"])
def test_gradients_of_the_network_agree_with_finite_differences(mode: str) -> None:
    field = network()
    t, x, t_ref = points()
    config = WarpConfig(solver="rk4", steps=60, gradient=mode)
    weights = torch.linspace(-1, 1, x.numel(), dtype=x.dtype).view_as(x)

    def loss() -> Tensor:
        return (weights * warp(field, t, x, t_ref, config)).sum()

    grads = torch.autograd.grad(loss(), list(field.parameters()))
    generator = torch.Generator().manual_seed(3)
    for parameter, grad in zip(field.parameters(), grads, strict=True):
        direction = torch.randn(parameter.shape, generator=generator, dtype=parameter.dtype)
        expected = along(loss, parameter, direction)
        # The adjoint retraces paths over the kinks of ReLU, which costs digits.
        tolerance = 1e-5 if mode == "backprop" else 2e-3
        found = (grad * direction).sum().item()
        assert found == pytest.approx(expected, rel=tolerance, abs=tolerance)


def saved_bytes(config: WarpConfig) -> int:
    """Bytes that autograd keeps for the backward pass, each storage counted once."""
    storages: dict[int, int] = {}

    def pack(tensor: Tensor) -> Tensor:
        storage = tensor.untyped_storage()
        storages[storage.data_ptr()] = storage.nbytes()
        return tensor

    field = network()
    t, x, t_ref = points(1000)
    with torch.autograd.graph.saved_tensors_hooks(pack, lambda tensor: tensor):
        moved = warp(field, t, x, t_ref, config)
    assert math.isfinite(moved.sum().item())
    return sum(storages.values())


def test_memory_of_the_adjoint_does_not_grow_with_the_steps() -> None:
    few = {m: saved_bytes(WarpConfig("rk4", 2, gradient=m)) for m in ("backprop", "adjoint")}
    many = {m: saved_bytes(WarpConfig("rk4", 16, gradient=m)) for m in ("backprop", "adjoint")}
    assert many["adjoint"] == few["adjoint"]
    assert many["backprop"] > 6 * few["backprop"]
    assert few["backprop"] > 10 * few["adjoint"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"solver": "rk5"}, "warp.solver: unknown solver 'rk5'; use one of euler"),
        ({"solver": "rk4", "steps": 0}, "warp.steps: 0 steps of rk4; give at least 1"),
        ({"solver": "dopri5", "steps": 4}, "warp.steps: dopri5 would ignore 4 steps"),
    ],
)
def test_settings_that_would_be_ignored_are_refused(
    options: dict[str, str | int], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        WarpConfig(**options)
    with pytest.raises(InputError):
        replace_options(WarpConfig(), options)
