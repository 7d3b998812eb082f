from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS: run `make test`")

from parameter_bench import Atomic, declare, parameter_nodes
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from emoflow_ros.config import Config, load_config
from emoflow_ros.errors import InputError
from emoflow_ros.node.parameters import Change, changes
from emoflow_ros.node.settings import NodeOptions, Settings, table

WARM = ("estimator.warm_iterations", 5)


@pytest.fixture
def make_node() -> Iterator[Callable[..., Any]]:
    with parameter_nodes() as make:
        yield make


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
        (
            "estimator__device",
            "cpu",
            r"^estimator\.device: only the profiles paper\* have a device, this one runs on the "
            r"processor; leave it out$",
        ),
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


@pytest.mark.parametrize(
    ("name", "nearest", "known"),
    [
        ("camera.calibration", "camera.calibration_file", "camera.calibration_file, camera.frame"),
        ("input.queue_window", "input.queue_windows", "input.type, input.timestamps"),
        ("output.twistrate", "output.twist_rate", "output.timeout_s, output.diagnostics_s"),
        ("speed", "scale.speed", "autostart, on_missing_device, worker_nice, input"),
    ],
)
def test_unknown_name_is_refused_with_the_nearest_and_those_beside_it(
    make_node: Callable[..., Any], name: str, nearest: str, known: str
) -> None:
    with pytest.raises(InputError) as caught:
        declare(make_node(**{name.replace(".", "__"): 1}))
    line = str(caught.value)
    expected = f"{name}: no such option, the nearest is {nearest}; known here: {known}"
    assert line.startswith(expected)
    if "." in name:
        assert "window." not in line


@pytest.mark.parametrize("configured", [True, False])
def test_own_dump_can_be_loaded(make_node: Callable[..., Any], configured: bool) -> None:
    """Also what cannot change, and what rclpy declares itself."""
    node = Atomic(make_node(window__duration_ms=50.0), configured)
    node.node.declare_parameter("qos_overrides./a", 1, ParameterDescriptor(read_only=True))
    dump = node.dump()
    assert {"profile", "use_sim_time", "qos_overrides./a"} <= {p.name for p in dump}
    assert [p.name for p in dump if not node.set(p).successful] == []
    assert node.set(*dump).successful
    assert node.parameters.settings.config.window.duration_ms == 50.0


def test_dump_with_a_change_of_what_is_fixed_is_refused(make_node: Callable[..., Any]) -> None:
    node = Atomic(make_node(), configured=True)
    for name, value in (("profile", "rigid"), ("input.queue_windows", 3)):
        changed = [p if p.name != name else Parameter(name, value=value) for p in node.dump()]
        assert not node.set(*changed).successful
        assert node.node.get_parameter(name).value != value
    assert node.changes == []


def test_unknown_name_while_running_is_refused_with_the_nearest(
    make_node: Callable[..., Any],
) -> None:
    node = Atomic(make_node(), configured=True)
    answer = node.set(Parameter("scale.sped", value=1.0))
    assert not answer.successful
    assert answer.reason.startswith("scale.sped: no such option, the nearest is scale.speed; known")


def test_a_parameter_of_an_earlier_version_is_left_out_with_a_warning(
    make_node: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    log = SimpleNamespace(warning=said.append)
    made = make_node(estimator__max_doubt=0.5)
    monkeypatch.setattr(made, "get_logger", lambda: log)
    node = Atomic(made, configured=True)
    assert node.parameters.settings == Settings(NodeOptions(), load_config())
    old, new = (Parameter(n, value=v) for n, v in (("estimator.max_doubt", 1.0), WARM))
    assert node.set(old, new).successful
    assert node.parameters.settings.config.estimator.warm_iterations == WARM[1]
    assert len(said) == 2
    assert all(line.startswith("estimator.max_doubt: no longer an option") for line in said)


def test_change_that_somebody_else_refuses_has_no_effect(make_node: Callable[..., Any]) -> None:
    node = make_node()
    parameters, changes = declare(node)
    before = parameters.settings
    refusal = SetParametersResult(successful=False, reason="no")
    node.add_on_set_parameters_callback(lambda _: refusal)
    node._on_set_parameters_callbacks.reverse()  # asked last
    [answer] = node.set_parameters([Parameter("window.duration_ms", value=45.0)])
    assert not answer.successful
    assert (parameters.settings, changes) == (before, [])


@pytest.mark.parametrize("ros_type", ["dvs_msgs/EventArray", "sensor_msgs/msg/Image", "events"])
def test_type_that_holds_no_events_is_refused_at_the_start(
    make_node: Callable[..., Any], ros_type: str
) -> None:
    match = (
        rf"^input\.type: there is no decoder for messages of type '{ros_type}'; use one of dv_ros"
    )
    with pytest.raises(InputError, match=match):
        declare(make_node(input__type=ros_type))


def test_method_brings_its_own_options(make_node: Callable[..., Any]) -> None:
    node = make_node(method="implicit", profile="paper")
    parameters, _ = declare(node)
    assert parameters.settings.config.method == "implicit"
    assert node.has_parameter("estimator.warp.solver")
    with pytest.raises(InputError, match="unknown 'magic'"):
        declare(make_node(method="magic"))
