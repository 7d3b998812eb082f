"""Names of lens models, and which model a list of coefficients belongs to."""

from collections.abc import Sequence
from dataclasses import dataclass

from emoflow_ros.errors import InputError

# Distortion models by their ROS name (sensor_msgs/CameraInfo), with the numbers of
# coefficients that each accepts.
DISTORTION_MODELS = {
    "none": (0,),
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8,),
    "equidistant": (4,),
}

_BROWN_CONRADY = ("plumb_bob", "rational_polynomial")
# Kalibr and older drivers call them so.
_OTHER_NAMES = {"radtan": "plumb_bob", "fisheye": "equidistant"}
# What ROS's own tools make of coefficients without a model's name.
_UNNAMED = {4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial"}


@dataclass(frozen=True)
class Lens:
    """A lens model and its coefficients.

    Attributes:
        model: a key of DISTORTION_MODELS.
        coefficients: as many as the model has.
        note: what was assumed, in words; empty where everything was said.
    """

    model: str
    coefficients: tuple[float, ...]
    note: str = ""


def choose_lens(name: str, d: Sequence[float]) -> Lens:
    """Choose the lens model that a calibration means.

    Zeros behind a model's coefficients are left out. plumb_bob with eight coefficients is OpenCV's
    rational model under its old name. Coefficients without a name are plumb_bob if they are 4 or
    5, and rational_polynomial if they are 8.

    Args:
        name: as the calibration gives it; may be empty.
        d: the coefficients.

    Raises:
        InputError: coefficients without a name, of another number.
    """
    word = name.strip().lower().replace(" ", "_")
    model = _OTHER_NAMES.get(word, word if word in DISTORTION_MODELS else name.strip())
    coefficients = tuple(float(value) for value in d)
    if model == "":
        return _unnamed(coefficients)
    if model == "plumb_bob" and len(coefficients) > max(DISTORTION_MODELS[model]):
        coefficients = _without_zeros(coefficients, (5, 8))
        if len(coefficients) == 8:
            model = "rational_polynomial"
    lengths = DISTORTION_MODELS.get(model, ())
    coefficients = _without_zeros(coefficients, tuple(filter(None, lengths)) or lengths)
    if model in _BROWN_CONRADY and len(coefficients) in lengths and not any(coefficients):
        return Lens("none", ())
    return Lens(model, coefficients)


def _unnamed(coefficients: tuple[float, ...]) -> Lens:
    if not any(coefficients):
        return Lens("none", ())
    chosen = _without_zeros(coefficients, tuple(_UNNAMED))
    if len(chosen) not in _UNNAMED:
        raise InputError(
            "camera",
            f"an empty distortion_model with {len(coefficients)} coefficients",
            f"name the model, one of {', '.join(DISTORTION_MODELS)}",
        )
    model = _UNNAMED[len(chosen)]
    note = f"distortion_model is empty; its {len(coefficients)} coefficients are taken as {model}"
    return Lens(model, chosen, note)


def _without_zeros(coefficients: tuple[float, ...], lengths: tuple[int, ...]) -> tuple[float, ...]:
    """Leave out zeros at the end, down to the nearest length that a model accepts."""
    for length in sorted(lengths, reverse=True):
        if length <= len(coefficients) and not any(coefficients[length:]):
            return coefficients[:length]
    return coefficients
