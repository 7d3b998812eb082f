"""Places in the image as bearings, with what is known of them."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.patch_kernels import INDEPENDENT
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.numerics.jit import njit

Array = NDArray[np.float64]
F32 = NDArray[np.float32]


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
    return _looked_up(camera.bearings, camera.flow_jacobian, place)


@njit(nogil=True)
def _looked_up(maps: F32, jacobians: F32, place: Array) -> tuple[Array, Array]:
    height, width = maps.shape[:2]
    bearing, jacobian = np.empty((len(place), 2)), np.empty((len(place), 2, 2))
    for n in range(len(place)):
        x, y = place[n, 0], place[n, 1]
        inside = 0 <= x < width - 1 and 0 <= y < height - 1
        j, i = (int(x), int(y)) if inside else (0, 0)
        x, y = x - j, y - i
        for d in range(2):
            jacobian[n, d, 0], jacobian[n, d, 1] = jacobians[i, j, d, 0], jacobians[i, j, d, 1]
            above = (1 - x) * maps[i, j, d] + x * maps[i, j + 1, d]
            below = (1 - x) * maps[i + 1, j, d] + x * maps[i + 1, j + 1, d]
            bearing[n, d] = (1 - y) * above + y * below if inside else np.nan
    return bearing, jacobian
