"""Estimators by configuration."""

from functools import partial

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config
from emoflow_ros.core.estimate import Estimator
from emoflow_ros.core.lattice_config import LatticeConfig


def make_estimator(camera: Camera, config: Config) -> Estimator:
    """Build the estimator that a configuration asks for.

    Only its own libraries are imported: the lattice on the processor needs no torch, the
    network no numba.

    Raises:
        InputError: the configuration asks for a device that is not there.
    """
    if isinstance(config.estimator, LatticeConfig):
        from emoflow_ros.core.lattice_estimator import LatticeEstimator

        if config.estimator.device == "cpu":
            return LatticeEstimator(camera, config.estimator)
        from emoflow_ros.core.contrast_torch import TorchContrast
        from emoflow_ros.core.device import require_cuda

        require_cuda()
        make_contrast = partial(
            TorchContrast, device=config.estimator.device, capacity=config.estimator.max_events
        )
        return LatticeEstimator(camera, config.estimator, make_contrast)
    from emoflow_ros.core.implicit.estimator import ImplicitEstimator

    return ImplicitEstimator(camera, config.estimator)
