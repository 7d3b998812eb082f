"""Poses in text files of TUM's format: `t tx ty tz qx qy qz qw`."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import Truth
from emoflow_ros.offline.truth.poses import TAKEN_AS_CAMERA, PoseTrack, PoseTwist, pose_track
from emoflow_ros.readers.ecd import read_table, require_increasing

_LAYOUT = "t tx ty tz qx qy qz qw"
_COLUMNS = 8
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
# Steps between poses that fit one unit only, if poses come at 1 Hz to 10 kHz.
_STEPS = ((NS_PER_S, 0.0, 1.0), (1000, 1e2, 1e5), (1, 1e6, 1e9))
_HEAD_BYTES = 4096


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
        InputError: lines of another length, times that do not increase or whose unit cannot be
            told, or quaternions that are none.
    """
    rows = read_table(path, _COLUMNS, _LAYOUT)
    stamps = np.rint(rows[:, 0] * _unit_ns(path, rows[:, 0])).astype(np.int64)
    require_increasing(path, stamps)
    return pose_track(path, stamps, rows[:, 1:4], rows[:, 4:])


def load_poses(path: Path, camera: Camera) -> Truth:
    """Take the velocity from a file's poses; see `read_poses`."""
    track = read_poses(path)
    return Truth(PoseTwist(track, path.name, TAKEN_AS_CAMERA), poses=track)


def _unit_ns(path: Path, t: NDArray[np.float64]) -> int:
    """Return the nanoseconds of a unit of t."""
    last = float(t[-1])
    if last >= _EPOCH_US:
        return 1 if last >= _EPOCH_NS else 1000
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    for unit, shortest, longest in _STEPS:
        if shortest <= step < longest:
            return unit
    if step < 0:
        return NS_PER_S  # not in order, which is refused in any unit
    raise InputError(path, f"poses are {step:g} units of time apart", "give t in seconds")
