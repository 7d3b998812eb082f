"""The node's ROS parameters: declared, checked and changed by the typed table of `settings`."""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from emoflow_ros.core.config import Config, load_config
from emoflow_ros.core.options import OptionInfo, unknown_option
from emoflow_ros.errors import InputError
from emoflow_ros.node.settings import NodeOptions, Settings, table

_INT64_MAX = 2**63 - 1
_ONLY_AT_START = ("autostart", "profile", "method")
_CONNECTIONS = (
    "input.",
    "camera.",
    "output.",
    "imu.",
    "estimator.device",
    "on_missing_device",
)
# Declared by rclpy itself.
_FOREIGN = ("use_sim_time", "start_type_description_service", "qos_overrides.")


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
