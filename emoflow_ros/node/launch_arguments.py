"""Arguments of the launch files: what is wrong with one is said before anything is started."""

import math
from pathlib import Path

from emoflow_ros.errors import InputError


def flag(name: str, text: str) -> bool:
    """Read an argument that is true or false, in any case.

    Raises:
        InputError: it is neither.
    """
    values = {"true": True, "false": False}
    if text.lower() not in values:
        raise InputError(name, f"'{text}' is neither true nor false", "use one of the two")
    return values[text.lower()]


def number(name: str, text: str) -> float:
    """Read an argument that is a number.

    Raises:
        InputError: it is none, or not a finite one.
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


def require_path(name: str, text: str) -> None:
    """Refuse a path where nothing is.

    Raises:
        InputError: there is nothing.
    """
    if not Path(text).exists():
        raise InputError(name, f"no file or folder '{text}'", "check the path")


def require_package(name: str, package: str) -> None:
    """Refuse an argument that needs a ROS package which is not installed.

    Raises:
        InputError: it is not.
    """
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        fix = f"install ros-jazzy-{package.replace('_', '-')} or leave {name} out"
        raise InputError(name, f"the package {package} is not installed", fix) from None
