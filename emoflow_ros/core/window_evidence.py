"""What a window's own flow, or a gyro, says of w: evidence for the adjustment of positions."""

import numpy as np

from emoflow_ros.core.back_end.evidence import Measured
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.refinement import rotation_by_parts
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.gyro import GyroState


def measured_by_window(
    found: Estimate, camera: Camera, settings: BackEndSettings
) -> tuple[Measured, ...]:
    """Tell what a window says of w; that no motion is seen in it says that w is small.

    A gyro tells how it changes, too, part by part; together they count as one.

    Args:
        found: what the lattice estimates of the window.
        camera: of the tracking image.
        settings: of the back end.
    """
    parts = settings.gyro_parts if found.gyro.state is GyroState.USED else 1
    angular, length = found.angular[None], found.t_end - found.t_start
    if found.motion is not None:
        angular = rotation_by_parts(found, parts) * (NS_PER_S / length)
    root = np.eye(3) / np.sqrt(len(angular) * variance_of_window(found, camera, settings))
    ends = found.t_start + np.arange(len(angular) + 1) * length // len(angular)
    return tuple(
        Measured(int(begin), int(end), w, root, found.linear)
        for begin, end, w in zip(ends[:-1], ends[1:], angular, strict=True)
    )


def variance_of_window(found: Estimate, camera: Camera, settings: BackEndSettings) -> float:
    """Variance of what a window says of w about each axis, (rad/s)^2. Arguments as above."""
    by_gyro = found.gyro.state is GyroState.USED
    spread = np.radians(settings.gyro_sd_deg if by_gyro else settings.lattice_sd_deg)
    if found.flow is None:
        seconds = (found.t_end - found.t_start) / NS_PER_S
        spread = settings.unseen_px / (camera.fx * seconds)
    return max(0.0, float(np.trace(found.covariance[3:, 3:])) / 3) + float(spread) ** 2
