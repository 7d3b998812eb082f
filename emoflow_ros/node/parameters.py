"""The node's parameters: one typed table, from which they are declared, checked and changed."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.exceptions import InvalidTopicNameException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.validate_full_topic_name import validate_full_topic_name

from emoflow_ros.core.clock import Timestamps
from emoflow_ros.core.config import Config, load_config
from emoflow_ros.core.options import (
    OptionInfo,
    option,
    options_of,
    replace_options,
    unknown_option,
)
from emoflow_ros.errors import InputError
from msg_adapters import supported_types

_INT64_MAX = 2**63 - 1
_ONLY_AT_START = ("autostart", "profile", "method")
_CONNECTIONS = ("input.", "camera.", "output.", "estimator.device", "on_missing_device")
# Declared by rclpy itself.
_FOREIGN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


@dataclass(frozen=True)
class InputOptions:
    """What the node listens to."""

    type: str = option(
        "", "message type of the topic `events`; empty takes the type that is published"
    )
    timestamps: str = option(
        "fused",
        "time of the output: the events' own times mapped to ROS time with their drift tracked "
        "(fused), mapped by each message's stamp (header), or unchanged (sensor)",
        choices=tuple(Timestamps),
    )
    queue_windows: int = option(
        8, "windows that may wait for the worker; one more drops the oldest", minimum=1, maximum=100
    )
    silence_s: float = option(
        2.0,
        "without events for this long the diagnostics warn",
        unit="s",
        minimum=0.1,
        maximum=3600.0,
    )

    def __post_init__(self) -> None:
        if self.type and self.type not in supported_types():
            raise InputError(
                "input.type",
                f"messages of type '{self.type}' hold no events",
                f"use one of {', '.join(supported_types())}",
            )


@dataclass(frozen=True)
class CameraOptions:
    """Which camera the events come from."""

    calibration_file: str = option(
        "",
        "camera_info YAML or ECD calib.txt, as a path, file:// or package:// URL; empty listens to "
        "the topic `camera_info`",
    )
    frame_id: str = option(
        "", "optical frame of the camera; empty takes the frame of the event messages"
    )


@dataclass(frozen=True)
class OutputOptions:
    """How the node answers."""

    timeout_s: float = option(
        10.0,
        "a worker without an answer after this long is replaced, the window is lost",
        unit="s",
        minimum=0.1,
        maximum=600.0,
    )
    diagnostics_s: float = option(
        1.0, "time between two diagnostics", unit="s", minimum=0.1, maximum=60.0
    )
    flow_color_max: float = option(
        0.0,
        "flow that `flow/color` shows in full colour, longer flow is darkened; 0 takes the 99th "
        "percentile of each picture",
        unit="px/s",
        minimum=0.0,
        maximum=1e6,
    )
    flow_stride: int = option(
        1,
        "every so many-th pixel of every so many-th row is published on `flow/image`; 2 makes its "
        "messages a quarter as large",
        minimum=1,
        maximum=64,
    )
    twist_rate: float = option(
        0.0,
        "twists per second on `egomotion/twist`, from the spline inside the windows; 0 gives one "
        "per window, at its middle",
        unit="Hz",
        minimum=0.0,
        maximum=1000.0,
    )
    tracks: int = option(
        150, "points that `flow/tracks` follows, spread over the image", minimum=1, maximum=2000
    )
    target_frame: str = option(
        "", "frame that twists are expressed in; empty is the camera's optical frame"
    )
    target_source: str = option(
        "tf",
        "rotation from the optical frame into output.target_frame: that of tf at the stamp, or "
        "the parameters output.target_roll, output.target_pitch and output.target_yaw",
        choices=("tf", "parameter"),
    )
    target_roll: float = option(
        0.0,
        "orientation of the optical frame in output.target_frame: roll about its x axis, first, "
        "as in URDF",
        unit="rad",
        minimum=-math.tau,
        maximum=math.tau,
    )
    target_pitch: float = option(
        0.0, "then pitch about its y axis", unit="rad", minimum=-math.tau, maximum=math.tau
    )
    target_yaw: float = option(
        0.0, "then yaw about its z axis", unit="rad", minimum=-math.tau, maximum=math.tau
    )


@dataclass(frozen=True)
class ScaleOptions:
    """How fast the camera travels, which its events do not show."""

    source: str = option(
        "none",
        "scale of the linear velocity: none gives a unit direction, parameter multiplies it by "
        "scale.speed, topic by the speed on scale.topic",
        choices=("none", "parameter", "topic"),
    )
    speed: float = option(
        1.0,
        "speed of the camera, taken as exact, if scale.source is parameter",
        unit="m/s",
        minimum=0.0,
        maximum=1000.0,
    )
    topic: str = option(
        "odom",
        "topic of the camera's speed if scale.source is topic: nav_msgs/Odometry, "
        "geometry_msgs/TwistStamped or std_msgs/Float64, found from the graph",
    )
    max_age_s: float = option(
        0.5,
        "a window further than this from every speed on scale.topic gives a unit direction",
        unit="s",
        minimum=0.001,
        maximum=60.0,
    )

    def __post_init__(self) -> None:
        try:
            validate_full_topic_name(expand_topic_name(self.topic, "node", "/"))
        except (InvalidTopicNameException, ValueError):
            raise InputError(
                "scale.topic", f"'{self.topic}' is not the name of a topic", "correct the name"
            ) from None


@dataclass(frozen=True)
class NodeOptions:
    """Options of the node itself; those of the estimation are in `Config`."""

    autostart: bool = option(True, "configure and activate the node without being asked")
    on_missing_device: str = option(
        "cpu",
        "where estimator.device is cuda and CUDA is missing or lost: estimate on the CPU, or "
        "refuse to configure and, when lost, try again",
        choices=("cpu", "refuse"),
    )
    input: InputOptions = field(default_factory=InputOptions)
    camera: CameraOptions = field(default_factory=CameraOptions)
    output: OutputOptions = field(default_factory=OutputOptions)
    scale: ScaleOptions = field(default_factory=ScaleOptions)


@dataclass(frozen=True)
class Settings:
    """The values of all parameters."""

    node: NodeOptions
    config: Config

    def changed(self, values: Mapping[str, Any]) -> "Settings":
        """Return a copy with the parameters of these names changed.

        Raises:
            InputError: an unknown name, or a value of the wrong type or range.
        """
        own = [o.name for o in options_of(self.node)]
        config = [o.name for o in options_of(self.config)]
        if unknown := [n for n in values if n not in own and n not in config]:
            raise unknown_option(unknown[0], [*own, *config])
        return Settings(
            replace_options(self.node, {n: v for n, v in values.items() if n in own}),
            replace_options(self.config, {n: v for n, v in values.items() if n not in own}),
        )


def table(settings: Settings) -> Iterable[OptionInfo]:
    """List all parameters."""
    yield from options_of(settings.node)
    yield from options_of(settings.config)


class Change(StrEnum):
    """When a parameter may change."""

    ANY_TIME = "any time"
    UNCONFIGURED = "unconfigured"
    AT_START = "at start"


def changes(name: str) -> Change:
    """Tell when a parameter may change.

    How windows are cut and estimated takes effect with the next window; the rest decides what
    the node connects to when it is configured.
    """
    if name in _ONLY_AT_START:
        return Change.AT_START
    return Change.UNCONFIGURED if name.startswith(_CONNECTIONS) else Change.ANY_TIME


class NodeParameters:
    """Declares the table on a node and keeps `settings` equal to the parameters.

    Args:
        node: to declare on.
        is_configured: whether only dynamic parameters may change now.
        on_change: called after a change was taken, with the new settings.

    Raises:
        InputError: the node was started with an unknown name or a bad value.
    """

    def __init__(
        self,
        node: Node,
        *,
        is_configured: Callable[[], bool],
        on_change: Callable[[Settings], None],
    ) -> None:
        self._is_configured = is_configured
        self._on_change = on_change
        # What the node was started with; rclpy would ignore names that are never declared.
        given = {
            name: parameter.value
            for name, parameter in node._parameter_overrides.items()
            if not name.startswith(_FOREIGN)
        }
        method = {"method": given["method"]} if "method" in given else {}
        config = load_config(str(given.get("profile", Config.profile)), method)
        self.settings = Settings(NodeOptions(), config).changed(given)
        for info in table(self.settings):
            node.declare_parameter(info.name, info.value, _descriptor(info), ignore_override=True)
        self._names = {info.name for info in table(self.settings)}
        self._node = node
        node.add_on_set_parameters_callback(self._validate)
        node.add_post_set_parameters_callback(self._take)

    def set_atomically(
        self,
        parameters: list[Parameter],
        set_all: Callable[[list[Parameter]], SetParametersResult],
    ) -> SetParametersResult:
        """Set parameters of the node, also of a dump that holds what cannot change.

        Args:
            parameters: to set, all or none.
            set_all: what rclpy does. It would refuse a read-only parameter that has its value
                already, and raise on an unknown name.
        """
        unknown = [p.name for p in parameters if not self._node.has_parameter(p.name)]
        if unknown:
            refusal = unknown_option(unknown[0], sorted(self._names))
            return SetParametersResult(successful=False, reason=str(refusal))
        wanted = [p for p in parameters if not (self._is_fixed(p.name) and self._has(p))]
        return set_all(wanted) if wanted else SetParametersResult(successful=True)

    def _is_fixed(self, name: str) -> bool:
        """Whether a parameter cannot change now."""
        if name not in self._names:
            return bool(self._node.describe_parameter(name).read_only)
        unconfigured = Change.UNCONFIGURED if not self._is_configured() else None
        return changes(name) not in (Change.ANY_TIME, unconfigured)

    def _has(self, parameter: Parameter) -> bool:
        now = self._node.get_parameter(parameter.name)
        return (now.type_, now.value) == (parameter.type_, parameter.value)

    def _own(self, parameters: list[Parameter]) -> dict[str, Any]:
        return {p.name: p.value for p in parameters if p.name in self._names}

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        values = self._own(parameters)
        fixed = [name for name in values if self._is_fixed(name)]
        if fixed:
            reason = f"{fixed[0]}: only changes while the node is unconfigured"
            return SetParametersResult(successful=False, reason=reason)
        try:
            self.settings.changed(values)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take(self, parameters: list[Parameter]) -> None:
        if values := self._own(parameters):
            self.settings = self.settings.changed(values)
            self._on_change(self.settings)


def _descriptor(info: OptionInfo) -> ParameterDescriptor:
    unit = f" [{info.unit}]" if info.unit else ""
    descriptor = ParameterDescriptor(
        description=info.description + unit,
        additional_constraints=f"one of {', '.join(info.choices)}" if info.choices else "",
        read_only=changes(info.name) is Change.AT_START,
    )
    if isinstance(info.value, float):
        low = -math.inf if info.minimum is None else float(info.minimum)
        high = math.inf if info.maximum is None else float(info.maximum)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif isinstance(info.value, int) and not isinstance(info.value, bool):
        low_int = -_INT64_MAX if info.minimum is None else int(info.minimum)
        high_int = _INT64_MAX if info.maximum is None else int(info.maximum)
        descriptor.integer_range = [IntegerRange(from_value=low_int, to_value=high_int)]
    return descriptor
