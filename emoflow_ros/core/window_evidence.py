"""What a window tells the memory of positions of w, and what that expects of the next window."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.evidence import Measured
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.front_end.appearance import unit
from emoflow_ros.core.front_end.slices import flow_at
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.gyro.settings import GYRO
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.refinement import rotation_by_parts
from emoflow_ros.core.odometry import Odometry, State
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.expected import Expected
from emoflow_ros.core.types.gyro import GyroState


def measured_by_window(
    found: Estimate, camera: Camera, settings: BackEndSettings
) -> tuple[Measured, ...]:
    """Tell what a window says of w; that no motion is seen in it says that w is small.

    A gyro tells how it changes, too, part by part; together they count as one. Its bias is in all.

    Args:
        found: what the lattice estimates of the window.
        camera: of the tracking image.
        settings: of the back end.
    """
    parts, variance = 1, variance_of_window(found, camera, settings)
    if found.gyro.state is GyroState.USED:
        parts = settings.gyro_parts
    if found.gyro.bias is not None:
        variance -= _variance(found.gyro.bias.covariance)
    angular, length = found.angular[None], found.t_end - found.t_start
    if found.motion is not None:
        angular = rotation_by_parts(found, parts) * (NS_PER_S / length)
    root = np.eye(3) / np.sqrt(len(angular) * variance)
    ends = found.t_start + np.arange(len(angular) + 1) * length // len(angular)
    return tuple(
        Measured(int(begin), int(end), w, root, found.linear, found.gyro.bias)
        for begin, end, w in zip(ends[:-1], ends[1:], angular, strict=True)
    )


def variance_of_window(found: Estimate, camera: Camera, settings: BackEndSettings) -> float:
    """Variance of what a window says of w about each axis, (rad/s)^2. Arguments as above."""
    own = np.radians(settings.lattice_sd_deg) ** 2
    if found.gyro.state is GyroState.USED:
        own = GYRO.floor**2 + GYRO.relative_floor**2 * float(found.angular @ found.angular)
    if found.flow is None:
        seconds = (found.t_end - found.t_start) / NS_PER_S
        own = (settings.unseen_px / (camera.fx * seconds)) ** 2
    return _variance(found.covariance[3:, 3:]) + float(own)


def _variance(covariance: NDArray[np.float64]) -> float:
    """Mean variance about the axes, (rad/s)^2; 0 where it is unknown."""
    return max(0.0, float(np.trace(covariance)) / 3)


def expected_by_memory(odometry: Odometry, state: State, image: WorkingImage) -> Expected | None:
    """Expect that all goes on as at the newest node; None where nothing is adjusted.

    Args:
        odometry: of the memory.
        state: what it remembers.
        image: that the patches are followed in.
    """
    motion = state.motion(int(state.t[-1])) if len(state.t) else None
    if motion is None:
        return None

    def flow(points: NDArray[np.float64]) -> NDArray[np.float64]:  # few windows ask for it
        return flow_at(odometry.scene_flow(state), points / image.sensor_px) * image.sensor_px

    return Expected(flow, motion.angular, unit(motion.linear))
