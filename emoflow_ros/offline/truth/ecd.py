"""Ground truth beside an ECD recording: `motion.txt` and `imu.txt`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import TrueTwist, Truth
from emoflow_ros.offline.truth.rotation import ConstantRotation
from emoflow_ros.readers.ecd import read_imu_text, read_table

GYRO_HALF_WIDTH_S = 0.01


def load_motion(path: Path, camera: Camera) -> Truth:
    """Read `wx wy wz` in rad/s: a slice that rotates at this constant rate.

    Raises:
        InputError: not three numbers.
    """
    angular = read_table(path, 3, "wx wy wz in rad/s")
    if len(angular) != 1:
        raise InputError(path, f"holds {len(angular)} lines", "give one line 'wx wy wz' in rad/s")
    rotation = ConstantRotation(camera, angular[0], path.name)
    return Truth(rotation, rotation)


def load_gyro(path: Path, camera: Camera) -> Truth:
    """Read `t ax ay az gx gy gz` in s, m/s^2 and rad/s: angular velocity from the gyroscope.

    Raises:
        InputError: lines of another length.
    """
    imu = read_imu_text(path)
    return Truth(GyroTwist(imu.t, imu.angular, imu.name))


class GyroTwist:
    """Angular velocity as the mean of the gyroscope's readings around a time.

    The DAVIS's axes are taken as the camera's, and the bias (up to a few deg/s) stays in: an
    independent check of the velocity from poses rather than a better one.

    Args:
        stamps: (N,) int64 ns, increasing.
        rates: (N, 3) rad/s.
        name: where they come from.
    """

    def __init__(self, stamps: NDArray[np.int64], rates: NDArray[np.float64], name: str) -> None:
        self._stamps = stamps
        self._rates = rates
        self.name = name
        self.description = (
            f"angular velocity: {name}, mean of the gyroscope within {GYRO_HALF_WIDTH_S * 1e3:.0f} "
            "ms, bias not removed, its axes taken as the camera's"
        )

    def twist(self, t: int) -> TrueTwist | None:
        """Angular velocity at time t (ns); None where no reading is near."""
        reach = round(GYRO_HALF_WIDTH_S * NS_PER_S)
        first, last = np.searchsorted(self._stamps, [t - reach, t + reach + 1])
        if first == last:
            return None
        return TrueTwist(angular=self._rates[first:last].mean(axis=0), linear=None)
