"""The loop: its phases, reference times and end, on a small window of random events."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from emoflow_ros.config import load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.published import fit as loop
from emoflow_ros.published.fit import Fit, Problem, fit
from emoflow_ros.published.implicit_config import (
    EarlyStopConfig,
    FieldConfig,
    ImplicitConfig,
    LossConfig,
    OptimizerConfig,
)
from emoflow_ros.published.losses import PixelMaps, smoothness_loss

DURATION = 0.09
CONFIG = ImplicitConfig(
    field=FieldConfig(layers=2, width=8),
    loss=LossConfig(contrast_only=4),
    optimizer=OptimizerConfig(iterations=8, field_rate=1e-3, final_field_rate=1e-3),
)


@pytest.fixture
def problem(small_camera: Camera) -> Problem:
    generator = torch.Generator().manual_seed(0)
    t = DURATION * torch.rand(300, generator=generator)
    x = (torch.rand(300, 2, generator=generator) * torch.tensor([80, 60])).floor()
    return Problem(t, x, DURATION, PixelMaps.of(small_camera, "cpu"))


def with_loss(**options: object) -> ImplicitConfig:
    return replace(CONFIG, loss=replace(CONFIG.loss, **options))


def is_untouched(result: Fit) -> bool:
    """Whether the motion is still where it started from."""
    points = (result.motion.angular_points, result.motion.linear_points)
    return all(bool((p == CONFIG.optimizer.motion_start).all()) for p in points)


@pytest.mark.parametrize("geometry", ["dec", "rotation"])
def test_motion_is_fitted_after_the_contrast_phase(problem: Problem, geometry: str) -> None:
    assert is_untouched(fit(problem, with_loss(geometry=geometry, contrast_only=8)))
    last = fit(problem, with_loss(geometry=geometry, contrast_only=7))
    angular = last.motion.angular_points.detach() - 0.2
    # Adam's first step is the learning rate, whatever the gradient's size.
    used = angular[angular != 0]
    np.testing.assert_allclose(used.abs(), CONFIG.optimizer.motion_rate, rtol=1e-3)
    assert len(used) == angular.numel()
    assert (last.motion.linear_points != 0.2).any() == (geometry == "dec")


def test_without_weight_there_is_no_geometric_loss(problem: Problem) -> None:
    assert is_untouched(fit(problem, with_loss(geometry_weight=0.0, contrast_only=0)))


def test_every_iteration_warps_to_a_time_of_its_own(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    def references(seed: int) -> np.ndarray:
        seen: list[float] = []

        def recorded(*arguments: Any) -> Tensor:
            seen.append(arguments[3].item())
            return original(*arguments)

        monkeypatch.setattr(loop, "warp", recorded)
        optimizer = replace(CONFIG.optimizer, iterations=200)
        fit(problem, replace(CONFIG, seed=seed, optimizer=optimizer))
        return np.array(seen)

    original = loop.warp
    first, again, other = references(3), references(3), references(4)
    np.testing.assert_array_equal(first, again)
    assert not np.isin(first, other).any()
    assert len(np.unique(first)) == len(first) == 200
    assert first.min() >= 0
    assert first.max() < DURATION
    # Uniform over the window: the largest gap to the distribution function (Kolmogorov).
    gap = np.abs(np.sort(first) / DURATION - (np.arange(200) + 0.5) / 200).max()
    assert gap < 1.63 / np.sqrt(200)


def test_smoothness_holds_the_flow_together(problem: Problem) -> None:
    def variation(weight: float) -> float:
        optimizer = replace(CONFIG.optimizer, iterations=60, field_rate=5e-3)
        field = fit(
            problem, replace(with_loss(smoothness_weight=weight), optimizer=optimizer)
        ).field
        middle = torch.tensor(DURATION / 2)
        return smoothness_loss(field, middle, 60, 80, DURATION).item()

    assert variation(10.0) < 0.5 * variation(0.0)


def test_the_penalty_of_residuals_reaches_the_field(problem: Problem) -> None:
    huber, squares = (
        fit(problem, with_loss(penalty=penalty, contrast_only=0)).field
        for penalty in ("huber", "squares")
    )
    pairs = zip(huber.parameters(), squares.parameters(), strict=True)
    assert any(bool((a != b).any()) for a, b in pairs)


def test_early_stopping_ends_after_burn_in_and_patience(
    problem: Problem,
) -> None:
    """Burn-in 300, patience 45: the 301st loss is the best, and 45 are no improvement on it."""
    published = load_config("paper_early_stop").estimator
    assert isinstance(published, ImplicitConfig)
    never = replace(published.early_stop, min_improvement=1e6)
    config = replace(
        CONFIG, early_stop=never, optimizer=replace(CONFIG.optimizer, iterations=1000),
        loss=replace(CONFIG.loss, contrast_only=200),
    )  # fmt: skip
    result = fit(problem, config)
    assert (result.iterations, result.stop_reason) == (346, "converged")


def test_published_values() -> None:
    """arXiv 2510.12753, its supplement and rebuttal; see docs/method.md."""
    paper = load_config("paper").estimator
    assert isinstance(paper, ImplicitConfig)
    assert (paper.field.layers, paper.field.width, paper.field.octaves) == (8, 256, 0)
    assert (paper.warp.solver, paper.warp.steps) == ("euler", 1)
    loss, optimizer = paper.loss, paper.optimizer
    assert (loss.contrast, loss.contrast_only, loss.geometry_weight) == ("both", 200, 2.5)
    assert (loss.geometry, loss.penalty, loss.huber_delta) == ("dec", "huber", 0.1)
    assert (optimizer.iterations, optimizer.algorithm) == (1000, "adam")
    assert (optimizer.field_rate, optimizer.final_field_rate) == (1e-4, 6.3e-5)
    assert (optimizer.motion_rate, optimizer.motion_start) == (1e-3, 0.2)
    assert paper.max_events == 30_000
    early = load_config("paper_early_stop").estimator
    assert isinstance(early, ImplicitConfig)
    assert early.early_stop == EarlyStopConfig(burn_in=300, patience=45, min_improvement=1e-3)
