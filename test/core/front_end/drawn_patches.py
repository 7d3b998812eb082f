"""Textures and patches of them, as a camera that moves sees them."""

import numpy as np
from scipy.ndimage import affine_transform, gaussian_filter, shift

from emoflow_ros.core.front_end.following import choose
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import Slice, grid_nodes
from emoflow_ros.core.geometry.camera import Camera

CAMERA = Camera(160, 120, 120.0, 120.0, 80.0, 60.0)
SETTINGS = FrontEndSettings()
ROWS, COLUMNS = grid_nodes(CAMERA.size).shape[:2]


def texture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 50 * gaussian_filter(rng.normal(size=(120, 160)), 2.0).astype(np.float32)


def slice_of(image: np.ndarray, t: int = 0, flow: tuple[float, float] = (10.0, 0.0)) -> Slice:
    image = np.ascontiguousarray(image, np.float32)
    grid = np.tile(np.array(flow, np.float32), (ROWS, COLUMNS, 1))
    return Slice.of(t, image, grid)


def moved(image: np.ndarray, x: float, y: float) -> np.ndarray:
    return shift(image, (y, x), order=3)


def first(image: np.ndarray) -> Patches:
    return choose(slice_of(image), Patches.none(), CAMERA, SETTINGS)


def rolled(image: np.ndarray, degrees: float, zoom: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The image turned and enlarged about its middle, and what that makes of offsets (x, y)."""
    angle = np.radians(degrees)
    shape = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    back = np.linalg.inv(shape)[::-1, ::-1]  # of (row, column)
    middle = np.array([59.5, 79.5])
    return affine_transform(image, back, middle - back @ middle, order=3), shape


def along(brightness: np.ndarray, degrees: float, t: int = 0) -> Slice:
    """Events of a picture's brightness that moves in a direction: its slopes along it."""
    u = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    slope_y, slope_x = np.gradient(brightness)
    return slice_of(u[0] * slope_x + u[1] * slope_y, t, tuple(20 * u))


def of_brightness(brightness: np.ndarray) -> Patches:
    return choose(along(brightness, 0.0), Patches.none(), CAMERA, SETTINGS)


def error(found: Patches, place: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(found.place - place, axis=1)[found.shown]))
