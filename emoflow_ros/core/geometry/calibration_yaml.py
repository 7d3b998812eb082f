"""The YAML files that calibration tools write: ROS camera_info, OpenCV's and Kalibr's camchain.

OpenCV's begin with `%YAML:1.0`, hold `!!opencv-matrix`, and name no lens model. In a camchain each
camera is an entry `cam0`, `cam1` and so on, with `intrinsics`, `resolution` and
`distortion_coeffs`.
"""

import re
from collections.abc import Sequence
from typing import Any

import yaml

from emoflow_ros.errors import InputError

type Fields = tuple[int, int, Sequence[float], str, Sequence[float]]

_FIX = "give a camera_info YAML as camera_calibration writes it, a Kalibr camchain or OpenCV's YAML"
_DIRECTIVE = re.compile(r"\A\ufeff?%YAML[^\n]*\n")
# As ROS, OpenCV's samples and `ros2 topic echo` write them, in small letters.
_WIDTH = ("image_width", "width")
_HEIGHT = ("image_height", "height")
_MATRIX = ("camera_matrix", "cameramatrix", "k")
_COEFFICIENTS = (
    "distortion_coefficients", "distortion_coeffs", "dist_coeffs", "distcoeffs", "d",
)  # fmt: skip
_MODEL = ("distortion_model",)
_FISHEYE = "fisheye_model"  # OpenCV's calibration sample
_PINHOLE = "pinhole"


class _Loader(yaml.SafeLoader):
    """Reads OpenCV's matrices as mappings."""


def _matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> Any:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix)


def read_yaml(text: str, choice: str = "") -> Fields:
    """Read a calibration.

    Args:
        text: of the file.
        choice: the name of one camera of a camchain; empty where it has only one.

    Returns:
        Width and height in px, K (9, row by row), the lens model's name, and its coefficients.

    Raises:
        InputError: not such a file.
    """
    tree = _parse(text)
    if not isinstance(tree, dict):
        raise InputError("yaml", "holds no mapping of names to values", _FIX)
    cameras = {
        str(name): value
        for name, value in tree.items()
        if isinstance(value, dict) and "intrinsics" in value
    }
    if cameras:
        return _from_kalibr(*_chosen(cameras, choice))
    if choice:
        raise InputError("yaml", f"holds no camera '{choice}'", "leave the name out")
    return _from_fields({str(name).lower(): value for name, value in tree.items()})


def _parse(text: str) -> Any:
    """Return the first document of a YAML file."""
    try:
        # YAML writes its version with a space, OpenCV with a colon.
        return next(iter(yaml.load_all(_DIRECTIVE.sub("", text), _Loader)), None)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = "" if mark is None else f", line {mark.line + 1}"
        problem = " ".join(str(error.problem).split())
        raise InputError("yaml", f"not YAML ({problem}{place})", _FIX) from None
    except (yaml.YAMLError, ValueError, RecursionError):
        raise InputError("yaml", "not YAML", _FIX) from None


def _chosen(cameras: dict[str, dict[str, Any]], choice: str) -> tuple[str, dict[str, Any]]:
    there = ", ".join(f"{name} ({camera.get('rostopic')})" for name, camera in cameras.items())
    if not choice and len(cameras) > 1:
        raise InputError(
            "camchain",
            f"a camchain of {len(cameras)} cameras: {there}",
            f"choose the event camera with FILE:{min(cameras)}",
        )
    choice = choice or next(iter(cameras))
    if choice not in cameras:
        raise InputError("camchain", f"holds no camera '{choice}'", f"its cameras: {there}")
    return choice, cameras[choice]


def _from_kalibr(name: str, camera: dict[str, Any]) -> Fields:
    kind = str(camera.get("camera_model", _PINHOLE))
    if kind != _PINHOLE:
        raise InputError("camchain", f"{name} is of the camera model '{kind}'", "calibrate pinhole")
    intrinsics = _numbers(camera, ("intrinsics",), name)
    if len(intrinsics) != 4:
        raise InputError("camchain", f"{name}.intrinsics has {len(intrinsics)} values", "give 4")
    fx, fy, cx, cy = intrinsics
    size = camera.get("resolution")
    if not isinstance(size, list) or len(size) != 2:
        raise InputError("camchain", f"{name}.resolution is {size!r}", "give width and height")
    width, height = (_pixels(value, f"{name}.resolution") for value in size)
    d = _numbers(camera, _COEFFICIENTS, name) if "distortion_coeffs" in camera else []
    k = (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    return width, height, k, str(camera.get("distortion_model") or ""), d


def _from_fields(info: dict[str, Any]) -> Fields:
    k = _numbers(info, _MATRIX)
    if len(k) != 9:
        raise InputError(
            "yaml", f"{_name(info, _MATRIX)} has {len(k)} values", "give 9, row by row"
        )
    width, height = (
        _pixels(info.get(_name(info, names)), _name(info, names)) for names in (_WIDTH, _HEIGHT)
    )
    model = str(info.get(_name(info, _MODEL)) or "")
    if not model and info.get(_FISHEYE):
        model = "equidistant"
    return width, height, k, model, _numbers(info, _COEFFICIENTS)


def _name(info: dict[str, Any], names: tuple[str, ...]) -> str:
    """Return the name that is there, or the first one."""
    return next((name for name in names if name in info), names[0])


def _numbers(info: dict[str, Any], names: tuple[str, ...], camera: str = "") -> list[float]:
    """Return a list of numbers, or those of a matrix's `data`."""
    name = _name(info, names)
    value: Any = info.get(name)
    try:
        return [float(v) for v in (value["data"] if isinstance(value, dict) else value)]
    except (KeyError, TypeError, ValueError):
        full = f"{camera}.{name}" if camera else f"{name}.data"
        wrong = f"{full} is missing or not a list of numbers"
        raise InputError("yaml", wrong, _FIX) from None


def _pixels(value: Any, name: str) -> int:
    if not isinstance(value, int):
        raise InputError("yaml", f"{name} is {value!r}", "give the size in whole pixels")
    return value
