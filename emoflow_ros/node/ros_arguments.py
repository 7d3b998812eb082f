"""ROS arguments that cannot be used, as one clear line instead of rclpy's traceback."""

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import remove_ros_args

from emoflow_ros.errors import InputError

# What rcl says, besides where in its source it does: `Couldn't parse KIND: 'ARGUMENT'. Error: WHY`.
_SOURCE_LINE = re.compile(r", at \S+:\d+")
_REFUSAL = re.compile(r"Couldn't parse (?P<kind>[^:']+): '(?P<argument>.+?)'\. Error: (?P<why>.*)")
_WRONG_QOS = re.compile(r"Unexpected QoS override for policy `(.+?)`: `(.*)`")
_WRONG_TYPE = re.compile(r"parameter '(.+?)' to '(.*)' of type '\w+', expecting type '\W*(\w+)")

_PARAMETER_FILE = "params file"
_FILE_FIX = "give a YAML file of ROS parameters, as `ros2 param dump` writes it"
# By what rcl calls it: what is wrong, where rcl itself only names its lexemes, and what to do.
_RULES = {
    "parameter override rule": ("not of the form NAME:=VALUE", "write -p NAME:=VALUE"),
    "remap rule": (
        "not of the form FROM:=TO with two ROS names",
        "write -r FROM:=TO, as in -r events:=/camera/events",
    ),
    "log level": ("not a log level", "use debug, info, warn, error or fatal"),
}
_FIX = "correct what follows --ros-args"
_ENVIRONMENT_FIX = (
    "check what follows --ros-args, and the variables ROS_* and RMW_* of the environment"
)


def own_arguments() -> list[str]:
    """Return the arguments of the command line that are not for ROS.

    Raises:
        InputError: those for ROS cannot be used.
    """
    with refused_in_one_line():
        return list(remove_ros_args(sys.argv)[1:])


@contextmanager
def refused_in_one_line() -> Iterator[None]:
    """Turn what rclpy raises for bad ROS arguments into an InputError.

    It is meant for `rclpy.init` and the making of a node, which read them. rclpy's exceptions
    have no parts, only their text.

    Raises:
        InputError: a ROS argument cannot be used, or rcl cannot start in this environment.
    """
    try:
        with refused_values():
            yield
    except rclpy_implementation.UnknownROSArgsError as error:
        names = ", ".join(re.findall(r"'([^']*)'", str(error))) or str(error)
        raise InputError("--ros-args", f"unknown argument {names}", _FIX) from None
    except rclpy_implementation.RCLInvalidROSArgsError as error:
        raise _refusal(_without_source(error)) from None
    except rclpy_implementation.RCLError as error:
        raise InputError("ROS", _without_source(error), _ENVIRONMENT_FIX) from None


@contextmanager
def refused_values() -> Iterator[None]:
    """Turn what rclpy raises for values of its own parameters into an InputError.

    Those are use_sim_time and the like, and qos_overrides, read at a subscription.

    Raises:
        InputError: a value cannot be used.
    """
    try:
        yield
    except (InvalidParameterTypeException, InvalidParameterValueException) as error:
        raise _bad_value(str(error)) from None
    except RuntimeError as error:
        if found := _WRONG_QOS.search(str(error)):
            where = f"qos_overrides.*.{found[1]}"
            wrong = f"'{found[2]}' is no such policy"
            raise InputError(where, wrong, "correct the value") from None
        raise


def _bad_value(text: str) -> InputError:
    if found := _WRONG_TYPE.search(text):
        name, value, kind = found.groups()
        wrong = f"'{value}' is not of type {kind.lower()}"
        return InputError(name, wrong, "correct the value")
    return InputError("--ros-args", " ".join(text.split()), "correct the value")


def _without_source(error: Exception) -> str:
    """Give the text of an error of rcl in one line, without the places in rcl's source."""
    return " ".join(_SOURCE_LINE.sub("", str(error)).split())


def _refusal(line: str) -> InputError:
    found = _REFUSAL.search(line)
    if found is None:
        wrong = line.removeprefix("Failed to parse ROS arguments: ").rstrip(".")
        return InputError("--ros-args", wrong, _FIX)
    kind, argument, why = found["kind"], found["argument"], found["why"]
    if kind == _PARAMETER_FILE:
        return InputError(
            argument, _unreadable(argument) or f"holds no parameters ({why})", _FILE_FIX
        )
    wrong, fix = _RULES.get(kind, (why, _FIX))
    return InputError(argument, wrong, fix)


def _unreadable(argument: str) -> str:
    """Say why the file of `--params-file PATH` cannot be read; empty if it can."""
    try:
        Path(argument.partition(" ")[2]).read_bytes()
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return ""
