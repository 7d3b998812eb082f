"""Files of `--params-file` that say nothing to the node: rcl takes them without a word."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from emoflow_ros.errors import InputError

FILE_FIX = "give a YAML file of ROS parameters, as `ros2 param dump` writes it"
_FLAG = "--params-file"
_PARAMETERS = "ros__parameters"


def require_parameters(arguments: Sequence[str], name: str) -> str:
    """Look into the parameter files of a command line; rcl reads them, and refuses bad ones.

    Args:
        arguments: of the command line.
        name: of the node, without its namespace, unless the arguments rename it.

    Returns:
        A line on the first file that holds parameters for other nodes only; empty if there is none.

    Raises:
        InputError: a file holds no parameters at all.
    """
    for argument in arguments:
        name = argument.removeprefix("__node:=") if argument.startswith("__node:=") else name
    line = ""
    for flag, path in pairwise(arguments):
        if flag != _FLAG:
            continue
        try:
            content = yaml.safe_load(Path(path).read_text())
        except (OSError, ValueError, yaml.YAMLError):
            continue
        nodes = list(_nodes(content))
        if not nodes:
            raise InputError(f"{_FLAG} {path}", "holds no parameters", FILE_FIX)
        if not line and not any(node.split("/")[-1] in (name, "*", "**") for node in nodes):
            line = f"{_FLAG} {path}: holds nothing for a node called {name}, only for "
            line += ", ".join(nodes)
    return line


def _nodes(content: Any, path: str = "") -> Iterator[str]:
    """Name the nodes that a file has parameters for."""
    if not isinstance(content, dict):
        return
    for key, value in content.items():
        if key == _PARAMETERS:
            if value:
                yield path or "/**"
        else:
            yield from _nodes(value, f"{path}/{str(key).lstrip('/')}")
