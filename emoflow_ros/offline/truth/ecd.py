"""Ground truth beside an ECD recording: `motion.txt`, `groundtruth.txt`, `imu.txt`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import TrueTwist, Truth
from emoflow_ros.offline.truth.poses import PoseTrack, PoseTwist
from emoflow_ros.offline.truth.rotation import ConstantRotation

GYRO_HALF_WIDTH_S = 0.01


def load_motion(path: Path, camera: Camera) -> Truth:
    """Read `wx wy wz` in rad/s: a slice that rotates at this constant rate.

    Raises:
        InputError: not three numbers.
    """
    angular = _table(path, 3, "wx wy wz in rad/s")
    if len(angular) != 1:
        raise InputError(path, f"holds {len(angular)} lines", "give one line 'wx wy wz' in rad/s")
    rotation = ConstantRotation(camera, angular[0], path.name)
    return Truth(rotation, rotation)


def load_poses(path: Path, camera: Camera) -> Truth:
    """Read `t px py pz qx qy qz qw` in s and m: the camera's poses in the world.

    Raises:
        InputError: lines of another length.
    """
    stamps, rows = _stamped(path, 8, "t px py pz qx qy qz qw")
    track = PoseTrack(stamps, rows[:, :3], rows[:, 3:])
    return Truth(PoseTwist(track, path.name), poses=track)


def load_gyro(path: Path, camera: Camera) -> Truth:
    """Read `t ax ay az gx gy gz` in s, m/s^2 and rad/s: angular velocity from the gyroscope.

    Raises:
        InputError: lines of another length.
    """
    stamps, rows = _stamped(path, 7, "t ax ay az gx gy gz")
    return Truth(GyroTwist(stamps, rows[:, 3:], path.name))


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


def _stamped(
    path: Path, columns: int, layout: str
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Split a table into times (N,) in ns and the other columns."""
    rows = _table(path, columns, layout)
    stamps = np.rint(rows[:, 0] * NS_PER_S).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise InputError(path, "times are not increasing", "sort the lines by time")
    return stamps, rows[:, 1:]


def _table(path: Path, columns: int, layout: str) -> NDArray[np.float64]:
    fix = f"give lines '{layout}'"
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(path, f"not a table of numbers ({error})", fix) from None
    if rows.size == 0 or rows.shape[1] != columns:
        raise InputError(path, f"lines of {rows.shape[1]} numbers", fix)
    return rows
