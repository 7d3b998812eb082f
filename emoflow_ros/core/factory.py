"""Estimators by configuration."""

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import Estimator
from emoflow_ros.core.lattice_estimator import LatticeEstimator


def make_estimator(camera: Camera, config: Config) -> Estimator:
    """Build the estimator that a configuration asks for."""
    return LatticeEstimator(camera, config.estimator)
