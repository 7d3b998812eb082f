from typing import Any

import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.types.options import options_of, replace_options
from emoflow_ros.published.implicit_config import ImplicitConfig


def load(profile: str) -> ImplicitConfig:
    estimator = load_config(profile).estimator
    assert isinstance(estimator, ImplicitConfig)
    return estimator


def changes(config: ImplicitConfig, base: ImplicitConfig) -> dict[str, Any]:
    before = {o.name: o.value for o in options_of(base)}
    return {o.name: o.value for o in options_of(config) if o.value != before[o.name]}


def test_the_defaults_are_the_paper_profile() -> None:
    assert load("paper") == ImplicitConfig()


def test_early_stopping_is_all_that_its_profile_changes() -> None:
    assert changes(load("paper_early_stop"), load("paper")).keys() == {"early_stop.patience"}
    assert load("paper").early_stop.patience == 0 < load("paper_early_stop").early_stop.patience


@pytest.mark.parametrize("option", list(options_of(ImplicitConfig())), ids=lambda o: o.name)
def test_every_default_lies_in_its_own_range(option: Any) -> None:
    config = replace_options(ImplicitConfig(), {option.name: option.value})
    assert config == ImplicitConfig()
