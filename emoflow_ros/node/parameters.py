"""The node's ROS parameters: declared, checked and changed by the typed table of `settings`.

`python -m emoflow_ros.node.parameters` writes docs/parameters.md from the same table.
"""

import argparse
import math
from collections.abc import Callable, Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from emoflow_ros.cli import run
from emoflow_ros.config import Config, load_config, without_removed
from emoflow_ros.core.types.options import OptionInfo, coerced, unknown_option
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
    "worker_nice",
)
# Declared by rclpy itself.
_FOREIGN = ("use_sim_time", "start_type_description_service", "qos_overrides.")

_PAGE_HEAD = """\
# Parameters of the node

Generated from the table that the node declares them from; write it anew with
`python -m emoflow_ros.node.parameters`. `evaluate --set NAME=VALUE` takes those of
`window.*`, `estimator.*` and `imu.*`, too.

A name that does not exist, or a value out of range, is refused with the reason. A dump of the
node (`ros2 param dump`) can be loaded again: what cannot change may be in it unchanged. Parameters
change at `any time` and count from the next window, while the node is `unconfigured`, or only
`at start`. What to choose: [operations](operations.md#parameters),
[method](method.md#parameters).
"""
_PAGE_COLUMNS = ("name", "type", "default", "unit", "range", "may change", "meaning")


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
        self._node = node
        given = self._without_removed(
            {
                name: parameter.value
                for name, parameter in node._parameter_overrides.items()
                if not name.startswith(_FOREIGN)
            }
        )
        method = {"method": given["method"]} if "method" in given else {}
        config = load_config(str(given.get("profile", Config.profile)), method)
        self.settings = Settings(NodeOptions(), config).changed(given)
        for info in table(self.settings):
            node.declare_parameter(info.name, info.value, _descriptor(info), ignore_override=True)
        self._infos = {info.name: info for info in table(self.settings)}
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
                already, and one of another type than declared, and raise on an unknown name.
        """
        kept = self._without_removed({p.name: p for p in parameters})
        parameters = [self._coerced(p) for p in parameters if p.name in kept]
        unknown = [p.name for p in parameters if not self._node.has_parameter(p.name)]
        if unknown:
            refusal = unknown_option(unknown[0], sorted(self._infos))
            return SetParametersResult(successful=False, reason=str(refusal))
        wanted = [p for p in parameters if not (self._is_fixed(p.name) and self._has(p))]
        return set_all(wanted) if wanted else SetParametersResult(successful=True)

    def _without_removed(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Leave out parameters of earlier versions, each with a line in the log."""
        log = self._node.get_logger()
        return without_removed(values, lambda name, line: log.warning(f"{name}: {line}"))

    def _coerced(self, parameter: Parameter) -> Parameter:
        """Undo what `ros2 param` makes of a value, which it reads as YAML."""
        info = self._infos.get(parameter.name)
        if info is None or parameter.value is None:
            return parameter
        value = coerced(parameter.value, info.value, info.choices)
        return Parameter(parameter.name, value=value)

    def _is_fixed(self, name: str) -> bool:
        """Whether a parameter cannot change now."""
        if name not in self._infos:
            return bool(self._node.describe_parameter(name).read_only)
        unconfigured = Change.UNCONFIGURED if not self._is_configured() else None
        return changes(name) not in (Change.ANY_TIME, unconfigured)

    def _has(self, parameter: Parameter) -> bool:
        now = self._node.get_parameter(parameter.name)
        return (now.type_, now.value) == (parameter.type_, parameter.value)

    def _own(self, parameters: list[Parameter]) -> dict[str, Any]:
        return {p.name: p.value for p in parameters if p.name in self._infos}

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


def render() -> str:
    """Render the page: all parameters, then the estimator's with the published method."""
    usual = list(table(Settings(NodeOptions(), load_config("realtime"))))
    published = table(Settings(NodeOptions(), load_config("paper")))
    own = (info for info in published if info.name.startswith("estimator."))
    parts = [
        _PAGE_HEAD,
        "## With the profile `realtime`\n",
        _render_table(usual),
        "## The estimator's with the profile `paper`\n",
        "They take the place of those above with `paper`, `paper_early_stop` and `paper_dsec`. The "
        "defaults are those of\n`paper`; `config/PROFILE.yaml` says what the other two change.\n",
        _render_table(own),
    ]
    return "\n".join(parts)


def _render_table(infos: Iterable[OptionInfo]) -> str:
    rows = [_PAGE_COLUMNS, ("---",) * len(_PAGE_COLUMNS), *map(_row, infos)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _row(info: OptionInfo) -> tuple[str, ...]:
    value = info.value
    default = str(value).lower() if isinstance(value, bool) else str(value)
    return (
        f"`{info.name}`",
        type(value).__name__,
        f"`{default}`" if default else "empty",
        info.unit,
        _range(info),
        str(changes(info.name)),
        info.description,
    )


def _range(info: OptionInfo) -> str:
    if info.choices:
        return ", ".join(f"`{choice}`" for choice in info.choices)
    match info.minimum, info.maximum:
        case None, None:
            return ""
        case low, None:
            return f"from {low:g}"
        case None, high:
            return f"up to {high:g}"
        case low, high:
            return f"{low:g} to {high:g}"


def main() -> int:
    """Write the page."""
    return run(_main)


def _main() -> int:
    parser = argparse.ArgumentParser(
        description="Write docs/parameters.md from the typed table.",
        epilog="Example: python -m emoflow_ros.node.parameters",
    )
    parser.add_argument(
        "path", nargs="?", type=Path, default=Path("docs/parameters.md"), help="page to write"
    )
    path: Path = parser.parse_args().path
    path.write_text(render())
    print(f"wrote {path}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
