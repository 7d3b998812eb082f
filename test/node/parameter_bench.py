"""Nodes with the table of parameters, and nothing else."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from rclpy.parameter import Parameter
from ros_nodes import ros_context

from emoflow_ros.node.parameters import NodeParameters
from emoflow_ros.node.settings import Settings


@contextmanager
def parameter_nodes() -> Iterator[Callable[..., Any]]:
    """Give a function that makes a node with these overrides."""
    with ros_context() as context:

        def make(**overrides: Any) -> Any:
            given = [Parameter(name.replace("__", "."), value=v) for name, v in overrides.items()]
            return rclpy.create_node("p", context=context, parameter_overrides=given)

        yield make


def declare(node: Any, configured: bool = True) -> tuple[NodeParameters, list[Settings]]:
    changes: list[Settings] = []
    parameters = NodeParameters(node, is_configured=lambda: configured, on_change=changes.append)
    return parameters, changes


class Atomic:
    """A node whose parameters are set as EstimatorNode does."""

    def __init__(self, node: Any, configured: bool) -> None:
        self.node = node
        self.parameters, self.changes = declare(node, configured)

    def set(self, *parameters: Parameter) -> Any:
        return self.parameters.set_atomically(list(parameters), self.node.set_parameters_atomically)

    def dump(self) -> list[Parameter]:
        names = self.node.list_parameters([], 0).names
        return [self.node.get_parameter(name) for name in names]
