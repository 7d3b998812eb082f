"""Estimators by configuration: the one place that knows both of `core` and of `published`."""

from emoflow_ros.config import Config, require_torch
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.stream.bounded_windows import BoundedWindows
from emoflow_ros.core.types.estimate import Estimator


def make_estimator(camera: Camera, config: Config) -> Estimator:
    """Build the estimator that a configuration asks for.

    Windows that hold more events than the estimator uses are thinned first. Only its own libraries
    are imported: the lattice needs no torch.

    Raises:
        InputError: the configuration asks for a device, or for PyTorch, that is not there.
    """
    require_torch(config)
    if isinstance(config.estimator, LatticeConfig):
        estimator = _make_lattice_estimator(camera, config, config.estimator)
    else:
        from emoflow_ros.published.estimator import ImplicitEstimator

        estimator = ImplicitEstimator(camera, config.estimator)
        if config.window.max_displacement_px > 0:
            from emoflow_ros.core.lattice.motion_windows import MotionWindows

            estimator = MotionWindows(estimator, camera, config.window)
    return BoundedWindows(estimator, config.event_budget)


def _make_lattice_estimator(camera: Camera, config: Config, lattice: LatticeConfig) -> Estimator:
    from emoflow_ros.core.gyro.gyro import Gyro
    from emoflow_ros.core.lattice.estimator import LatticeEstimator
    from emoflow_ros.core.lattice.motion_windows import MotionWindows
    from emoflow_ros.core.products.continuous import ContinuousEstimator
    from emoflow_ros.core.remembering import RememberingEstimator
    from emoflow_ros.core.stream.cleaning import CleanWindows

    by_motion = config.window.max_displacement_px > 0
    gyro = Gyro(config.imu, by_windows=not lattice.remembers)
    fit = LatticeEstimator(camera, lattice, gyro, whole=not by_motion)
    estimator: Estimator = fit
    if by_motion:
        estimator = MotionWindows(estimator, camera, config.window)
    if lattice.remembers:
        estimator = RememberingEstimator(estimator, camera, fit.refined, learn_bias=gyro.learn_bias)
    estimator = ContinuousEstimator(estimator, camera, lattice)
    return CleanWindows(estimator, camera)
