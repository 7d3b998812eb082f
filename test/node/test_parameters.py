from collections.abc import Callable, Iterator
from typing import Any

import pytest

rclpy = pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from emoflow_ros.core.config import Config, load_config  # noqa: E402
from emoflow_ros.errors import InputError  # noqa: E402
from emoflow_ros.node.parameters import (  # noqa: E402
    Change,
    NodeOptions,
    NodeParameters,
    Settings,
    changes,
    table,
)


@pytest.fixture
def make_node() -> Iterator[Callable[..., Any]]:
    context = Context()
    rclpy.init(context=context)
    nodes = []

    def make(**overrides: Any) -> Any:
        given = [Parameter(name.replace("__", "."), value=v) for name, v in overrides.items()]
        nodes.append(rclpy.create_node("p", context=context, parameter_overrides=given))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def declare(node: Any, configured: bool = True) -> tuple[NodeParameters, list[Settings]]:
    changes: list[Settings] = []
    parameters = NodeParameters(node, is_configured=lambda: configured, on_change=changes.append)
    return parameters, changes


def test_every_option_is_declared_with_its_value_and_range(make_node: Callable[..., Any]) -> None:
    node = make_node()
    parameters, _ = declare(node)
    infos = list(table(parameters.settings))
    assert len({i.name for i in infos}) == len(infos)
    for info in infos:
        assert node.get_parameter(info.name).value == info.value
        descriptor = node.describe_parameter(info.name)
        assert info.description in descriptor.description
        assert info.unit in descriptor.description
        if isinstance(info.value, float) and info.minimum is not None:
            assert descriptor.floating_point_range[0].from_value == info.minimum


def test_defaults_are_those_of_the_profile(make_node: Callable[..., Any]) -> None:
    parameters, _ = declare(make_node())
    assert parameters.settings == Settings(NodeOptions(), load_config(Config().profile))


def test_start_values_count_and_whole_numbers_are_fine(make_node: Callable[..., Any]) -> None:
    node = make_node(window__duration_ms=50, input__queue_windows=3)
    parameters, _ = declare(node)
    assert parameters.settings.config.window.duration_ms == 50.0
    assert parameters.settings.node.input.queue_windows == 3
    assert node.get_parameter("window.duration_ms").value == 50.0


@pytest.mark.parametrize(
    ("name", "value", "match"),
    [
        ("window__duration", 50.0, "no such option"),
        ("window__duration_ms", 0.0, "out of range"),
        ("input__queue_windows", "many", "not of type int"),
        ("profile", "warp", "unknown profile"),
        ("output__target_source", "guess", "use one of tf, parameter"),
        ("scale__topic", "my odometry", "is not the name of a topic"),
    ],
)
def test_bad_start_values_are_refused(
    make_node: Callable[..., Any], name: str, value: Any, match: str
) -> None:
    with pytest.raises(InputError, match=match):
        declare(make_node(**{name: value}))


def test_dynamic_parameter_changes_the_settings(make_node: Callable[..., Any]) -> None:
    node = make_node()
    parameters, changes = declare(node)
    [answer] = node.set_parameters([Parameter("window.duration_ms", value=45.0)])
    assert answer.successful
    assert parameters.settings.config.window.duration_ms == 45.0
    assert changes == [parameters.settings]


def test_fixed_parameter_changes_only_while_unconfigured(make_node: Callable[..., Any]) -> None:
    change = [Parameter("input.queue_windows", value=3)]
    node = make_node()
    parameters, changes = declare(node, configured=True)
    [answer] = node.set_parameters(change)
    assert not answer.successful
    assert "unconfigured" in answer.reason
    assert changes == []
    node = make_node()
    parameters, _ = declare(node, configured=False)
    [answer] = node.set_parameters(change)
    assert answer.successful
    assert parameters.settings.node.input.queue_windows == 3


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("window.duration_ms", -1.0),
        ("window.stride_ms", 50000.0),
        ("window.count", -1),
        ("scale.topic", "/a//b"),
        ("scale.max_age_s", 0.0),
    ],
)
def test_bad_change_is_refused_with_the_reason(
    make_node: Callable[..., Any], name: str, value: Any
) -> None:
    node = make_node()
    parameters, changes = declare(node)
    before = parameters.settings
    [answer] = node.set_parameters([Parameter(name, value=value)])
    assert not answer.successful
    assert name in answer.reason
    assert parameters.settings == before
    assert changes == []


@pytest.mark.parametrize(
    ("name", "value"), [("profile", "realtime"), ("autostart", False), ("method", "implicit")]
)
def test_what_only_counts_at_the_start_cannot_change(
    make_node: Callable[..., Any], name: str, value: Any
) -> None:
    node = make_node()
    declare(node, configured=False)
    [answer] = node.set_parameters([Parameter(name, value=value)])
    assert not answer.successful


def test_unknown_parameter_cannot_be_set(make_node: Callable[..., Any]) -> None:
    node = make_node()
    declare(node)
    with pytest.raises(rclpy.exceptions.ParameterNotDeclaredException):
        node.set_parameters([Parameter("window.duration", value=1.0)])


@pytest.mark.parametrize(
    ("name", "when"),
    [
        ("window.duration_ms", Change.ANY_TIME),
        ("estimator.max_events", Change.ANY_TIME),
        ("scale.speed", Change.ANY_TIME),
        ("scale.topic", Change.ANY_TIME),
        ("output.target_frame", Change.UNCONFIGURED),
        ("input.type", Change.UNCONFIGURED),
        ("camera.frame_id", Change.UNCONFIGURED),
        ("output.timeout_s", Change.UNCONFIGURED),
        ("profile", Change.AT_START),
        ("method", Change.AT_START),
    ],
)
def test_what_the_node_connects_to_is_not_dynamic(name: str, when: Change) -> None:
    assert changes(name) is when


def test_method_brings_its_own_options(make_node: Callable[..., Any]) -> None:
    node = make_node(method="implicit", profile="paper")
    parameters, _ = declare(node)
    assert parameters.settings.config.method == "implicit"
    assert node.has_parameter("estimator.warp.solver")
    with pytest.raises(InputError, match="unknown 'magic'"):
        declare(make_node(method="magic"))
