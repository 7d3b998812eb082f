"""Ground truth in text files: poses of TUM's format, and ECD's `motion.txt` and `imu.txt`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.stamps import distinct
from emoflow_ros.readers.text_tables import read_imu_text, read_table
from emoflow_ros.truth.ground_truth import (
    TAKEN_AS_CAMERA,
    PoseTrack,
    PoseTwist,
    TrueFlow,
    TrueTwist,
    Truth,
    pose_track,
)

_LAYOUT = "t tx ty tz qx qy qz qw"
_COLUMNS = 8
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
# Steps between poses that fit one unit only, if poses come at 1 Hz to 10 kHz.
_STEPS = ((NS_PER_S, 0.0, 1.0), (1000, 1e2, 1e5), (1, 1e6, 1e9))
_HEAD_BYTES = 4096
GYRO_HALF_WIDTH_S = 0.01


def is_tum(path: Path) -> bool:
    """Whether the path is a text file whose first line but for comments has eight numbers."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        lines = file.read(_HEAD_BYTES).splitlines()
    first = next((line for line in lines if line.strip() and not line.startswith(b"#")), b"")
    try:
        return len([float(word) for word in first.split()]) == _COLUMNS
    except ValueError:
        return False


def read_poses(path: Path) -> PoseTrack:
    """Read poses as world-from-camera, in m; t is in s, us or ns, by the step between poses.

    Raises:
        InputError: lines of another length, times that go back or whose unit cannot be told, or
            quaternions without a length.
    """
    rows = read_table(path, _COLUMNS, _LAYOUT)
    stamps = np.rint(rows[:, 0] * _unit_ns(path, rows[:, 0])).astype(np.int64)
    kept = distinct(path, stamps)
    return pose_track(path, stamps[kept], rows[kept, 1:4], rows[kept, 4:])


def load_poses(path: Path, camera: Camera) -> Truth:
    """Take the velocity from a file's poses; see `read_poses`."""
    track = read_poses(path)
    return Truth(PoseTwist(track, path.name, TAKEN_AS_CAMERA), poses=track)


def _unit_ns(path: Path, t: NDArray[np.float64]) -> int:
    """Return the nanoseconds of a unit of t."""
    last = float(t[-1])
    if last >= _EPOCH_US:
        return 1 if last >= _EPOCH_NS else 1000
    steps = np.diff(t)
    if (steps < 0).any() or not steps.any():
        return NS_PER_S  # refused in any unit, or a single time
    step = float(np.median(steps[steps > 0]))
    for unit, shortest, longest in _STEPS:
        if shortest <= step < longest:
            return unit
    raise InputError(path, f"poses are {step:g} units of time apart", "give t in seconds")


class ConstantRotation:
    """Twist and flow of a pure rotation; its flow needs no depth.

    Args:
        camera: the camera.
        angular: (3,) rad/s in its optical frame.
        name: where the rate comes from.
    """

    def __init__(self, camera: Camera, angular: NDArray[np.float64], name: str) -> None:
        self._angular = angular
        self._camera = camera
        self.name = name
        self.description = f"velocity and flow: {name}, constant rotation about the camera's centre"

    def twist(self, t: int) -> TrueTwist:
        """Return the constant rate; translation is not observable."""
        return TrueTwist(angular=self._angular, linear=None)

    def displacement(self, t0: int, t1: int) -> TrueFlow:
        """Displacement of every pixel whose ray stays in front of the camera."""
        camera = self._camera
        bearings = camera.bearings.astype(np.float64)
        rays = np.concatenate([bearings, np.ones((*bearings.shape[:2], 1))], axis=-1)
        rotation = Rotation.from_rotvec(self._angular * (t1 - t0) / NS_PER_S).as_matrix()
        moved = rays @ rotation  # rows times R = R^T times columns: points rotate the other way
        grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
        with np.errstate(invalid="ignore"):
            flow = camera.project(moved) - grid
        valid = np.isfinite(flow).all(axis=-1) & (moved[..., 2] > 0)
        return TrueFlow(np.where(valid[..., None], flow, 0).astype(np.float32), valid)


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

    The DAVIS's axes are taken as the camera's. With its bias (up to a few deg/s) it is an
    independent check of the velocity from poses rather than a better one.

    Args:
        stamps: (N,) int64 ns, increasing.
        rates: (N, 3) rad/s.
        name: where they come from.
        bias: what became of it, in words.
    """

    def __init__(
        self,
        stamps: NDArray[np.int64],
        rates: NDArray[np.float64],
        name: str,
        bias: str = "bias not removed",
    ) -> None:
        self._stamps = stamps
        self._rates = rates
        self.name = name
        self.description = (
            f"angular velocity: {name}, mean of the gyroscope within {GYRO_HALF_WIDTH_S * 1e3:.0f} "
            f"ms, {bias}, its axes taken as the camera's"
        )

    def twist(self, t: int) -> TrueTwist | None:
        """Angular velocity at time t (ns); None where no reading is near."""
        reach = round(GYRO_HALF_WIDTH_S * NS_PER_S)
        first, last = np.searchsorted(self._stamps, [t - reach, t + reach + 1])
        if first == last:
            return None
        return TrueTwist(angular=self._rates[first:last].mean(axis=0), linear=None)
