"""Camera calibration from files and from the fields of a camera_info message."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from emoflow_ros.core.geometry.calibration_yaml import read_yaml
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.errors import InputError

DAVIS240C = (240, 180)

_YAML = (".yaml", ".yml")
_TEXT_FIX = "give one line 'fx fy cx cy k1 k2 p1 p2 k3'"


def load_calibration(path: Path, size: tuple[int, int] | None = None) -> Camera:
    """Read a camera from a calibration file.

    `*.yaml` and `*.yml` are ROS camera_info files (image_width, image_height, camera_matrix,
    distortion_model, distortion_coefficients), Kalibr's camchains or what OpenCV writes (see
    calibration_yaml.py). Any other name is the text format of the Event-Camera Dataset,
    `fx fy cx cy k1 k2 p1 p2 k3` (plumb_bob), which holds no sensor size.

    Args:
        path: the file; `FILE:cam1` is one camera of a camchain of several.
        size: (width, height) in px of the sensor of a text file, by default that of the
            dataset's DAVIS240C.

    Returns:
        The camera; its `note` says what was assumed.

    Raises:
        InputError: no such file, or contents that are not a calibration.
    """
    file, choice = path, ""
    name, colon, last = path.name.rpartition(":")
    if colon and not path.exists():
        file, choice = path.with_name(name), last
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise InputError(file, reason, "give a calibration file that can be read") from None
    except UnicodeDecodeError:
        raise InputError(file, "not a text file", "give a calibration file") from None
    try:
        if file.suffix.lower() in _YAML or text.startswith("%YAML"):
            return Camera.from_intrinsic_matrix(*read_yaml(text, choice))
        return Camera.from_intrinsic_matrix(*_read_text(text, size or DAVIS240C))
    except InputError as error:
        raise InputError(file, error.wrong, error.fix) from None


def camera_from_info(info: Any, where: object, option: str) -> Camera:
    """Build the camera of a sensor_msgs/CameraInfo of ROS 1 or ROS 2.

    Args:
        info: the message.
        where: its topic, for errors.
        option: what gives a calibration instead, for errors.

    Raises:
        InputError: the camera is not calibrated, or its lens model is unknown.
    """
    k, d = (info.K, info.D) if hasattr(info, "K") else (info.k, info.d)
    try:
        return Camera.from_intrinsic_matrix(info.width, info.height, k, info.distortion_model, d)
    except InputError as error:
        raise InputError(where, error.wrong, f"{error.fix}, or give {option}") from None


def _read_text(
    text: str, size: tuple[int, int]
) -> tuple[int, int, Sequence[float], str, Sequence[float]]:
    """Read ECD's line: width, height, K, lens model and coefficients."""
    try:
        lines = (line.partition("#")[0] for line in text.splitlines())
        values = [float(word) for line in lines for word in line.split()]
    except ValueError:
        raise InputError("text", "holds words that are not numbers", _TEXT_FIX) from None
    if len(values) != 9:
        raise InputError("text", f"holds {len(values)} numbers", _TEXT_FIX)
    fx, fy, cx, cy, *distortion = values
    return *size, (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0), "plumb_bob", distortion
