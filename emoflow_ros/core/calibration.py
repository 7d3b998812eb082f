"""Camera calibration from files: ROS camera_info YAML and ECD `calib.txt`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from emoflow_ros.core.camera import Camera
from emoflow_ros.errors import InputError

DAVIS240C = (240, 180)

_YAML_FIX = "give a file as camera_calibration writes it (camera_info YAML)"
_TEXT_FIX = "give one line 'fx fy cx cy k1 k2 p1 p2 k3'"


def load_calibration(path: Path, size: tuple[int, int] | None = None) -> Camera:
    """Read a camera from a calibration file.

    `*.yaml` and `*.yml` are ROS camera_info files (image_width, image_height, camera_matrix,
    distortion_model, distortion_coefficients); any other name is the text format of the
    Event-Camera Dataset, `fx fy cx cy k1 k2 p1 p2 k3` (plumb_bob), which holds no sensor size.

    Args:
        path: the file.
        size: (width, height) in px of the sensor of a text file, by default that of the
            dataset's DAVIS240C.

    Raises:
        InputError: no such file, or contents that are not a calibration.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(path, reason, "give a calibration file that can be read") from None
    except UnicodeDecodeError:
        raise InputError(path, "not a text file", "give a calibration file") from None
    if path.suffix.lower() in (".yaml", ".yml"):
        return _from_camera_info(path, text)
    return _from_text(path, text, size or DAVIS240C)


def _from_camera_info(path: Path, text: str) -> Camera:
    try:
        info = yaml.safe_load(text)
    except yaml.YAMLError as error:
        line = " ".join(str(error).split())
        raise InputError(path, f"not YAML ({line})", _YAML_FIX) from None
    if not isinstance(info, dict):
        raise InputError(path, "holds no mapping of names to values", _YAML_FIX)
    k = _floats(path, info, "camera_matrix")
    if len(k) != 9:
        raise InputError(path, f"camera_matrix has {len(k)} values", "give 9, row by row")
    return _camera(
        path,
        _integer(path, info, "image_width"),
        _integer(path, info, "image_height"),
        k,
        str(info.get("distortion_model") or ""),
        _floats(path, info, "distortion_coefficients"),
    )


def _from_text(path: Path, text: str, size: tuple[int, int]) -> Camera:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        raise InputError(path, "holds words that are not numbers", _TEXT_FIX) from None
    if len(values) != 9:
        raise InputError(path, f"holds {len(values)} numbers", _TEXT_FIX)
    fx, fy, cx, cy, *distortion = values
    matrix = (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    return _camera(path, *size, matrix, "plumb_bob", distortion)


def _camera(
    path: Path, width: int, height: int, k: Sequence[float], model: str, d: Sequence[float]
) -> Camera:
    """Build the camera; what it refuses is the file's fault."""
    try:
        return Camera.from_intrinsic_matrix(width, height, k, model, d)
    except InputError as error:
        wrong, _, fix = str(error).removeprefix("camera: ").partition("; ")
        raise InputError(path, wrong, fix) from None


def _floats(path: Path, info: dict[str, Any], name: str) -> Sequence[float]:
    try:
        return [float(value) for value in info[name]["data"]]
    except (KeyError, TypeError, ValueError):
        wrong = f"{name}.data is missing or not a list of numbers"
        raise InputError(path, wrong, _YAML_FIX) from None


def _integer(path: Path, info: dict[str, Any], name: str) -> int:
    value = info.get(name)
    if not isinstance(value, int):
        raise InputError(path, f"{name} is {value!r}", "give the size in whole pixels")
    return value
