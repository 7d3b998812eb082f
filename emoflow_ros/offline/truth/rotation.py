"""Truth of a camera that rotates at a constant rate about its centre."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.offline.truth.base import TrueFlow, TrueTwist


class ConstantRotation:
    """Twist and flow of a pure rotation; its flow needs no depth.

    Args:
        camera: the camera.
        angular: (3,) rad/s in its optical frame.
        name: where the rate comes from.
    """

    def __init__(self, camera: Camera, angular: NDArray[np.float64], name: str) -> None:
        self._angular = angular
        self._camera = camera
        self.name = name
        self.description = f"velocity and flow: {name}, constant rotation about the camera's centre"

    def twist(self, t: int) -> TrueTwist:
        """Return the constant rate; translation is not observable."""
        return TrueTwist(angular=self._angular, linear=None)

    def displacement(self, t0: int, t1: int) -> TrueFlow:
        """Displacement of every pixel whose ray stays in front of the camera."""
        camera = self._camera
        bearings = camera.bearings.astype(np.float64)
        rays = np.concatenate([bearings, np.ones((*bearings.shape[:2], 1))], axis=-1)
        turned = Rotation.from_rotvec(self._angular * (t1 - t0) / NS_PER_S).as_matrix()
        moved = rays @ turned  # rows times R = R^T times columns: points turn the other way
        grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
        with np.errstate(invalid="ignore"):
            flow = camera.project(moved) - grid
        valid = np.isfinite(flow).all(axis=-1) & (moved[..., 2] > 0)
        return TrueFlow(np.where(valid[..., None], flow, 0).astype(np.float32), valid)
