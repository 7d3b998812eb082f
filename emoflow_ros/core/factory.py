"""Estimators by configuration."""

from functools import partial

from emoflow_ros.core.bounded_windows import BoundedWindows
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config, GyroConfig, require_cuda, require_torch
from emoflow_ros.core.estimate import Estimator
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.thinning import EventBudget


def make_estimator(camera: Camera, config: Config) -> Estimator:
    """Build the estimator that a configuration asks for.

    Windows that hold more events than the estimator uses are thinned first. Only its own libraries
    are imported: the lattice on the processor needs no torch.

    Raises:
        InputError: the configuration asks for a device, or for PyTorch, that is not there.
    """
    require_torch(config)
    if isinstance(config.estimator, LatticeConfig):
        estimator = _make_lattice_estimator(camera, config.estimator, config.imu)
    else:
        from emoflow_ros.core.implicit.estimator import ImplicitEstimator

        estimator = ImplicitEstimator(camera, config.estimator)
    if config.window.max_displacement_px > 0:
        from emoflow_ros.core.motion_windows import MotionWindows

        estimator = MotionWindows(estimator, camera, config.window)
    if isinstance(config.estimator, LatticeConfig):
        from emoflow_ros.core.doubt import ReliableOnly
        from emoflow_ros.core.preparation import CleanWindows

        estimator = CleanWindows(estimator, camera)
        if config.estimator.max_doubt < 1:
            estimator = ReliableOnly(estimator, config.estimator.max_doubt)
    return BoundedWindows(estimator, EventBudget(config.window, config.estimator.max_events))


def _make_lattice_estimator(camera: Camera, config: LatticeConfig, imu: GyroConfig) -> Estimator:
    from emoflow_ros.core.lattice_estimator import LatticeEstimator

    if config.device == "cpu":
        return LatticeEstimator(camera, config, imu=imu)
    from emoflow_ros.core.contrast_torch import TorchContrast

    require_cuda()
    make_contrast = partial(TorchContrast, device=config.device, capacity=config.max_events)
    return LatticeEstimator(camera, config, make_contrast, imu)
