"""Ground truth beside an ECD recording: `motion.txt`, `groundtruth.txt`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import Truth
from emoflow_ros.offline.truth.poses import PoseTrack, PoseTwist
from emoflow_ros.offline.truth.rotation import ConstantRotation


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
    rows = _table(path, 8, "t px py pz qx qy qz qw")
    stamps = np.rint(rows[:, 0] * NS_PER_S).astype(np.int64)
    if (np.diff(stamps) <= 0).any():
        raise InputError(path, "times are not increasing", "sort the poses by time")
    return Truth(PoseTwist(PoseTrack(stamps, rows[:, 1:4], rows[:, 4:]), path.name))


def _table(path: Path, columns: int, layout: str) -> NDArray[np.float64]:
    fix = f"give lines '{layout}'"
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(path, f"not a table of numbers ({error})", fix) from None
    if rows.size == 0 or rows.shape[1] != columns:
        raise InputError(path, f"lines of {rows.shape[1]} numbers", fix)
    return rows
