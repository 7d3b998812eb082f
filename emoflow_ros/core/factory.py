"""Estimators by configuration."""

from collections.abc import Callable
from functools import partial

from emoflow_ros.core.bounded_windows import BoundedWindows
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import Config, GyroConfig, require_cuda, require_torch
from emoflow_ros.core.estimate import Estimator, FlowSampler
from emoflow_ros.core.events import Window
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.thinning import EventBudget

Look = Callable[[Window], FlowSampler | None]


def make_estimator(camera: Camera, config: Config) -> Estimator:
    """Build the estimator that a configuration asks for.

    Windows that hold more events than the estimator uses are thinned first. Only its own libraries
    are imported: the lattice on the processor needs no torch.

    Raises:
        InputError: the configuration asks for a device, or for PyTorch, that is not there.
    """
    require_torch(config)
    if isinstance(config.estimator, LatticeConfig):
        estimator, look = _make_lattice_estimator(camera, config.estimator, config.imu)
    else:
        from emoflow_ros.core.implicit.estimator import ImplicitEstimator

        estimator, look = ImplicitEstimator(camera, config.estimator), _nothing
    if config.window.max_displacement_px > 0:
        from emoflow_ros.core.motion_windows import MotionWindows

        estimator = MotionWindows(estimator, camera, config.window, look)
    if isinstance(config.estimator, LatticeConfig):
        from emoflow_ros.core.doubt import ReliableOnly
        from emoflow_ros.core.preparation import CleanWindows

        estimator = CleanWindows(estimator, camera)
        if config.estimator.max_doubt < 1:
            estimator = ReliableOnly(estimator, config.estimator.max_doubt)
    return BoundedWindows(estimator, EventBudget(config.window, config.estimator.max_events))


def _nothing(window: Window) -> None:
    """Look at a window without a quick way to its flow."""


def _make_lattice_estimator(
    camera: Camera, config: LatticeConfig, imu: GyroConfig
) -> tuple[Estimator, Look]:
    from emoflow_ros.core.lattice_estimator import LatticeEstimator
    from emoflow_ros.core.second_look import QuickLook

    if config.device == "cpu":
        return LatticeEstimator(camera, config, imu=imu), QuickLook(camera, config).flow
    from emoflow_ros.core.contrast_torch import TorchContrast

    require_cuda()
    make_contrast = partial(TorchContrast, device=config.device, capacity=config.max_events)
    look = QuickLook(camera, config, make_contrast).flow
    return LatticeEstimator(camera, config, make_contrast, imu), look
