"""Dumped, loaded, set and given on the command line, a value stays what it is."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

rclpy = pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from parameter_bench import Atomic, declare, parameter_nodes  # noqa: E402
from rcl_interfaces.msg import Parameter as ParameterMessage  # noqa: E402
from rclpy.parameter import (  # noqa: E402
    Parameter,
    get_parameter_value,
    parameter_dict_from_yaml_file,
)

ODD = {
    "window.duration_ms": 50.0,
    "scale.speed": 1.0,
    "imu.use": "off",
    "imu.bias_walk": 1e-5,
    "scale.topic": "odom",
    "camera.frame_id": "7",
    "output.target_yaw": -1e-7,
}


@pytest.fixture
def make_node() -> Iterator[Callable[..., Any]]:
    with parameter_nodes() as make:
        yield make


def written(dump: list[Parameter], path: Path) -> Path:
    """The file that `ros2 param dump` writes."""
    tree: dict[str, Any] = {}
    for parameter in dump:
        *groups, name = parameter.name.split(".")
        branch = tree
        for group in groups:
            branch = branch.setdefault(group, {})
        branch[name] = parameter.value
    path.write_text(yaml.dump({"/p": {"ros__parameters": tree}}, default_flow_style=False))
    return path


@pytest.mark.parametrize("configured", [True, False])
@pytest.mark.parametrize("profile", ["realtime", "paper"])
def test_dump_is_loaded_and_started_with_as_it_is(
    make_node: Callable[..., Any], tmp_path: Path, profile: str, configured: bool
) -> None:
    """As `ros2 param load` reads it, and as `--params-file` does."""
    odd = ODD if profile == "realtime" else {"estimator.optimizer.field_rate": 1e-5}
    given = {name.replace(".", "__"): value for name, value in odd.items()}
    node = Atomic(make_node(profile=profile, **given), configured)
    path = written(node.dump(), tmp_path / "dump.yaml")
    loaded = parameter_dict_from_yaml_file(str(path)).values()
    refused = {m.name: node.set(Parameter.from_parameter_msg(m)) for m in loaded}
    assert {name: r.reason for name, r in refused.items() if not r.successful} == {}
    arguments = ["--ros-args", "--params-file", str(path)]
    other = rclpy.create_node("p", context=node.node.context, cli_args=arguments)
    assert declare(other)[0].settings == node.parameters.settings
    values = {p.name: p.value for p in node.dump()}
    assert {name: values[name] for name in odd} == odd


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("scale.speed", "1", 1.0),
        ("window.duration_ms", "5e1", 50.0),
        ("imu.use", "off", "off"),
        ("camera.frame_id", "7", "7"),
        ("input.queue_windows", "3", 3),
    ],
)
def test_set_takes_what_the_command_line_takes(
    make_node: Callable[..., Any], name: str, text: str, value: Any
) -> None:
    """As `ros2 param set`, and as `-p`."""
    node = Atomic(make_node(imu__use="auto"), configured=False)
    message = ParameterMessage(name=name, value=get_parameter_value(text))
    assert node.set(Parameter.from_parameter_msg(message)).successful
    arguments = ["--ros-args", "-p", f"{name}:={text}"]
    other = rclpy.create_node("p", context=node.node.context, cli_args=arguments)
    declare(other)
    assert node.node.get_parameter(name).value == other.get_parameter(name).value == value


@pytest.mark.parametrize(
    ("name", "text"),
    [("scale.speed", "much"), ("input.queue_windows", "1.5"), ("camera.frame_id", "true")],
)
def test_set_refuses_another_type_all_the_same(
    make_node: Callable[..., Any], name: str, text: str
) -> None:
    node = Atomic(make_node(), configured=False)
    before = node.node.get_parameter(name).value
    message = ParameterMessage(name=name, value=get_parameter_value(text))
    assert not node.set(Parameter.from_parameter_msg(message)).successful
    assert node.node.get_parameter(name).value == before
