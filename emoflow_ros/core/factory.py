"""Estimators by configuration."""

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import Estimator
from emoflow_ros.core.lattice_config import LatticeConfig


def make_estimator(camera: Camera, config: Config) -> Estimator:
    """Build the estimator that a configuration asks for.

    Only its own libraries are imported: the lattice needs no torch, the network no numba.

    Raises:
        InputError: the configuration asks for a device that is not there.
    """
    if isinstance(config.estimator, LatticeConfig):
        from emoflow_ros.core.lattice_estimator import LatticeEstimator

        return LatticeEstimator(camera, config.estimator)
    from emoflow_ros.core.implicit.estimator import ImplicitEstimator

    return ImplicitEstimator(camera, config.estimator)
