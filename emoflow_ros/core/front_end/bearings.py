"""Places in the image as bearings, with what is known of them."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.patch_kernels import INDEPENDENT
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.geometry.camera import Camera

Array = NDArray[np.float64]


def on_plane(
    camera: Camera, place: Array, information: Array, age: Array, settings: FrontEndSettings
) -> tuple[Array, Array]:
    """Bring positions (N, 2) px and their information (N, 2, 2) to the normalised plane.

    Neighbouring pixels' residuals go together, so that only a share of the information counts; and
    appearance changes with the time since the first one, age (N,) s.

    Returns:
        (N, 2) bearings, NaN where the lens has none, and (N, 2, 2) square roots of the information.
    """
    seen, jacobian = looked_up(camera, place)
    value, vector = np.linalg.eigh(information)
    noise = settings.noise_px**2 * (1 + settings.ageing * age)
    variance = 1 / np.maximum(INDEPENDENT * value, 1e-6) + noise[:, None]
    root = (vector / np.sqrt(variance)[:, None, :]).transpose(0, 2, 1)
    return seen, root @ np.linalg.inv(np.where(np.isfinite(jacobian), jacobian, np.eye(2)))


def looked_up(camera: Camera, place: Array) -> tuple[Array, Array]:
    """Bearings (N, 2) and flow Jacobians (N, 2, 2) at places (N, 2) px, off the camera's maps.

    Quicker than `Camera.undistort`. Linear between whole pixels; NaN off the image and where the
    lens has no inverse.
    """
    low = np.floor(np.nan_to_num(place, nan=-1.0)).astype(np.int64)
    inside = ((low >= 0) & (low < np.array(camera.size) - 1)).all(axis=1)
    low = np.where(inside[:, None], low, 0)
    x, y = (place - low).T[..., None]
    column, row = low.T
    maps = camera.bearings
    above = (1 - x) * maps[row, column] + x * maps[row, column + 1]
    below = (1 - x) * maps[row + 1, column] + x * maps[row + 1, column + 1]
    bearing = np.where(inside[:, None], (1 - y) * above + y * below, np.nan)
    return bearing, camera.flow_jacobian[row, column].astype(np.float64)
