"""Arguments for ROS, of the executables and of the launch files.

What is wrong with one becomes an InputError of one line, before anything is started.
"""

import math
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.utilities import remove_ros_args

from emoflow_ros.core.types.options import unknown_option
from emoflow_ros.errors import InputError
from emoflow_ros.node.parameter_files import FILE_FIX, require_parameters

# What rcl says, besides where in its source it does: `Couldn't parse KIND: 'ARGUMENT'. Error: WHY`.
_SOURCE_LINE = re.compile(r", at \S+:\d+")
_REFUSAL = re.compile(r"Couldn't parse (?P<kind>[^:']+): '(?P<argument>.+?)'\. Error: (?P<why>.*)")
_WRONG_QOS = re.compile(r"Unexpected QoS override for policy `(.+?)`: `(.*)`")
_WRONG_TYPE = re.compile(r"parameter '(.+?)' to '(.*)' of type '\w+', expecting type '\W*(\w+)")

_PARAMETER_FILE = "params file"
# By what rcl calls the argument: what is wrong (rcl itself names its lexemes only), what to do.
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


def own_arguments(name: str) -> list[str]:
    """Return the arguments of the command line that are not for ROS.

    A parameter file that holds nothing for the node is named on standard error.

    Args:
        name: of the node.

    Raises:
        InputError: those for ROS cannot be used.
    """
    with refused_in_one_line():
        own = list(remove_ros_args(sys.argv)[1:])
    if line := require_parameters(sys.argv, name):
        print(f"warning: {line}", file=sys.stderr, flush=True)
    return own


@contextmanager
def refused_in_one_line() -> Iterator[None]:
    """Turn what rclpy raises for bad ROS arguments into an InputError.

    It is meant for `rclpy.init` and the constructor of a node, which read them. The exceptions of
    rclpy hold nothing but text, so the text is searched.

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


def flag(name: str, text: str) -> bool:
    """Read a launch argument that is true or false, in any case.

    Raises:
        InputError: it is neither.
    """
    values = {"true": True, "false": False}
    if text.lower() not in values:
        raise InputError(name, f"'{text}' is neither true nor false", "use one of the two")
    return values[text.lower()]


def number(name: str, text: str) -> float:
    """Read a launch argument that is a number.

    Raises:
        InputError: it is not a number, or not a finite one.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(name, f"'{text}' is not a number", "give one, as in 10.0")
    return value


def parameter_file(text: str, sensors: Path) -> str:
    """Find a parameter file by its path, or by the name of one in the folder of sensors.

    Raises:
        InputError: there is none.
    """
    named = sensors / f"{text}.yaml"
    if named.is_file():
        return str(named)
    if Path(text).is_file():
        return text
    known = ", ".join(sorted(path.stem for path in sensors.glob("*.yaml")))
    raise InputError("params_file", f"no file '{text}'", f"give a path or one of {known}")


def is_launched(*files: str) -> bool:
    """Whether `ros2 launch` was given one of these launch files, and no other that includes it."""
    return any(Path(argument).name in files for argument in sys.argv[1:])


def refuse_unknown(file: str, known: Iterable[str]) -> None:
    """Refuse arguments of `ros2 launch` that a launch file does not have.

    Where another file includes it, the arguments are those of that one, and not looked at.

    Raises:
        InputError: there is one, with the nearest name.
    """
    if not is_launched(file):
        return
    given = [name for name, is_argument, _ in (a.partition(":=") for a in sys.argv) if is_argument]
    names = list(known)
    if unknown := [name for name in given if name not in names]:
        raise unknown_option(unknown[0], names)


def require_success(name: str, code: int) -> None:
    """Refuse the exit code of a process that was launched.

    Raises:
        InputError: it is not 0. In a launch file that ends all, with an exit code.
    """
    if code:
        raise InputError(name, f"ended with exit code {code}", "what it said last tells why")


def require_path(name: str, text: str) -> None:
    """Refuse a launch argument that is the path of no file or folder.

    Raises:
        InputError: there is none.
    """
    if not Path(text).exists():
        raise InputError(name, f"no file or folder '{text}'", "check the path")


def require_package(name: str, package: str) -> None:
    """Refuse a launch argument that needs a ROS package which is not installed.

    Raises:
        InputError: the package is not installed.
    """
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        fix = f"install ros-jazzy-{package.replace('_', '-')} or leave {name} out"
        raise InputError(name, f"the package {package} is not installed", fix) from None


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
            argument, _unreadable(argument) or f"holds no parameters ({why})", FILE_FIX
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
