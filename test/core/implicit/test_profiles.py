from pathlib import Path
from typing import Any

import pytest
import yaml

from emoflow_ros.core.implicit.config import ImplicitConfig
from emoflow_ros.core.options import options_of, replace_options

CONFIG = Path(__file__).parents[3] / "config"


def load(profile: str) -> ImplicitConfig:
    """Apply a profile's section for this estimator, which must name known options only."""
    section = yaml.safe_load((CONFIG / f"{profile}.yaml").read_text())["implicit"]
    values: dict[str, Any] = {}
    for name, value in section.items():
        group = value if isinstance(value, dict) else {}
        values |= {f"{name}.{key}": inner for key, inner in group.items()} or {name: value}
    return replace_options(ImplicitConfig(), values)


def changes(config: ImplicitConfig, base: ImplicitConfig) -> dict[str, Any]:
    before = {o.name: o.value for o in options_of(base)}
    return {o.name: o.value for o in options_of(config) if o.value != before[o.name]}


def test_the_defaults_are_the_paper_profile() -> None:
    assert load("paper") == ImplicitConfig()


def test_early_stopping_is_all_that_its_profile_changes() -> None:
    assert changes(load("paper_early_stop"), load("paper")) == {"early_stop.patience": 45}


def test_dsec_differs_as_published() -> None:
    assert changes(load("paper_dsec"), load("paper")) == {
        "field.octaves": 6,
        "loss.smoothness_weight": 0.15,
        "optimizer.algorithm": "adamw",
        "optimizer.schedule": "cosine",
        "optimizer.field_rate": 2e-3,
        "optimizer.final_field_rate": 2e-5,
        "optimizer.warmup": 100,
    }


@pytest.mark.parametrize("option", list(options_of(ImplicitConfig())), ids=lambda o: o.name)
def test_every_default_lies_in_its_own_range(option: Any) -> None:
    config = replace_options(ImplicitConfig(), {option.name: option.value})
    assert config == ImplicitConfig()
