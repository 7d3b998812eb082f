"""The launch files' arguments, as parameters of the node."""

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

FILE = Path(__file__).resolve().parents[2] / "launch" / "estimator.launch.py"


class Argument:
    """Stands for launch's LaunchConfiguration, with a dict for the context."""

    def __init__(self, name: str) -> None:
        self.name = name

    def perform(self, context: dict[str, str]) -> str:
        return context[self.name]


@pytest.fixture
def parameters(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what the node is given for these arguments."""
    for module, name, stand_in in (
        ("launch.substitutions", "LaunchConfiguration", Argument),
        ("launch_ros.actions", "Node", SimpleNamespace),
    ):
        fake: Any = ModuleType(module)
        setattr(fake, name, stand_in)
        monkeypatch.setitem(sys.modules, module.partition(".")[0], ModuleType("package"))
        monkeypatch.setitem(sys.modules, module, fake)
    launched = runpy.run_path(str(FILE))
    defaults = {name: default for name, (default, _) in launched["ARGUMENTS"].items()}

    def given(**arguments: str) -> dict[str, Any]:
        [node] = launched["_start"](defaults | arguments)
        first: dict[str, Any] = node.parameters[0]
        return first

    return given


def test_speed_is_a_scale_only_when_it_is_given(parameters: Any) -> None:
    assert not {name for name in parameters() if name.startswith("scale.")}
    with_speed = parameters(speed="2.5")
    assert (with_speed["scale.source"], with_speed["scale.speed"]) == ("parameter", 2.5)


def test_twist_rate_is_passed_as_a_number(parameters: Any) -> None:
    assert parameters()["output.twist_rate"] == 0.0
    assert parameters(twist_rate="200")["output.twist_rate"] == 200.0
