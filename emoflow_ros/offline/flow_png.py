"""DSEC's flow images: 16-bit PNGs of x, y and validity (Gehrig et al., 3DV 2021)."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.errors import InputError

_PER_PX = 128
_ZERO = 1 << 15
_MAX = np.iinfo(np.uint16).max


def read_flow_png(path: Path) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Read a displacement (H, W, 2) in px, zero where not valid, and where it is valid (H, W).

    Raises:
        InputError: no such file, or not an image of three 16-bit channels.
    """
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) if path.is_file() else None
    if image is None:
        raise InputError(path, "missing or damaged", "copy the sequence's flow images again")
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint16:
        raise InputError(path, "not a PNG of three 16-bit channels", "give DSEC's flow images")
    rgb = image[..., ::-1]  # OpenCV's order is blue, green, red
    valid = rgb[..., 2] > 0
    flow = (rgb[..., :2].astype(np.float32) - _ZERO) / _PER_PX
    return np.where(valid[..., None], flow, np.float32(0)), valid


def write_flow_png(path: Path, flow: NDArray[np.floating]) -> None:
    """Write a displacement (H, W, 2) in px, every pixel valid.

    Values are rounded to 1/128 px and limited to what 16 bits hold, -256 to 256 px.
    """
    values = np.clip(np.rint(flow * _PER_PX) + _ZERO, 0, _MAX).astype(np.uint16)
    ones = np.ones((*flow.shape[:2], 1), np.uint16)
    rgb = np.concatenate([values, ones], axis=-1)
    if not cv2.imwrite(str(path), rgb[..., ::-1]):
        raise InputError(path, "cannot be written", "give another --submission")
