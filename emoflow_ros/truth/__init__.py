"""Ground truth of recordings in every format.

It is the velocity of the camera, the displacement of its pixels, or both.
"""

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.errors import InputError
from emoflow_ros.readers import Recording, require_camera
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.dsec import DsecFolder
from emoflow_ros.readers.hdf5_columns import ColumnsRecording
from emoflow_ros.truth.bag_truth import load_bag_truth
from emoflow_ros.truth.dsec_flow import DsecFlow
from emoflow_ros.truth.flow_maps import PropagatedFlow
from emoflow_ros.truth.ground_truth import FlowSource, TrueFlow, TrueTwist, Truth, TwistSource
from emoflow_ros.truth.mvsec_truth import (
    MvsecFlowMaps,
    SmoothedOdometry,
    is_mvsec_truth,
    load_mvsec_truth,
)
from emoflow_ros.truth.text_truth import is_tum, load_gyro, load_motion, load_poses

__all__ = [
    "DsecFlow",
    "FlowSource",
    "PropagatedFlow",
    "TrueFlow",
    "TrueTwist",
    "Truth",
    "TwistSource",
    "load_truth",
    "truth_beside",
]
_STAMPED = "stamped_groundtruth.txt"
# Files that lie in the folder of a recording, the best first.
_BY_NAME: dict[str, Callable[[Path, Camera], Truth]] = {
    "motion.txt": load_motion,
    "groundtruth.txt": load_poses,
    _STAMPED: load_poses,
    "imu.txt": load_gyro,
}


def load_truth(recording: Recording, paths: Sequence[Path] = ()) -> Truth:
    """Read the ground truth of a recording.

    Args:
        recording: the recording, with a camera.
        paths: bags or an MVSEC `*_gt.hdf5` with poses and depth, MVSEC's flow or odometry npz,
            a DSEC sequence, poses as text lines `t tx ty tz qx qy qz qw`, ECD's `motion.txt` or
            `imu.txt`. Without any, what `truth_beside` finds. Of several velocities the first one
            counts and the others stand beside it, smoothed ones last; of several flows the first
            one counts, flow maps before depth.

    Raises:
        InputError: a file that is missing or of no known format.
    """
    camera = require_camera(recording)
    paths = paths or truth_beside(recording)
    parts = [_load(path, camera, recording.topic) for path in sorted(paths, key=_rank)]
    twists = [part.twists for part in parts if part.twists]
    return Truth(
        next(iter(twists), None),
        next((part.flows for part in parts if part.flows), None),
        tuple(twists[1:]),
        next((part.poses for part in parts if part.poses), None),
    )


def truth_beside(recording: Recording) -> list[Path]:
    """List the ground truth in a recording's folder, or beside its file of HDF5 columns."""
    path = recording.path
    if DsecFolder(path).recognised:
        return [path] if DsecFolder(path).has_flow else []
    folder = path.parent if isinstance(recording, ColumnsRecording) else path
    names = _BY_NAME if folder == path else (_STAMPED,)
    return [folder / name for name in names if (folder / name).is_file()]


def _rank(path: Path) -> int:
    if path.suffix != ".npz":
        return 1
    return 2 if _is_odometry(path) else 0


def _load(path: Path, camera: Camera, topic: str) -> Truth:
    if not path.exists():
        raise InputError(path, "no such file or folder", "check the path given with --gt")
    if path.name in _BY_NAME:
        return _BY_NAME[path.name](path, camera)
    if path.suffix == ".npz":
        if _is_odometry(path):
            return Truth(SmoothedOdometry(path))
        return Truth(flows=PropagatedFlow(MvsecFlowMaps(path)))
    if BagRecording.matches(path):
        namespace = topic.strip("/").rpartition("/")[0]  # HDF5 files have no leading slash
        return load_bag_truth(path, camera, f"/{namespace}")
    if is_mvsec_truth(path):
        return load_mvsec_truth(path, camera)
    if is_tum(path):
        return load_poses(path, camera)
    if DsecFolder(path).recognised:
        return Truth(flows=DsecFlow(DsecFolder(path)))
    raise InputError(
        path,
        "not ground truth of a known format",
        "give a bag, an MVSEC gt.hdf5, flow or odometry npz, a DSEC sequence, "
        f"poses as lines 't tx ty tz qx qy qz qw', {' or '.join(_BY_NAME)}",
    )


def _is_odometry(path: Path) -> bool:
    """Whether an npz archive holds velocities instead of flow."""
    return zipfile.is_zipfile(path) and "lin_vel.npy" in zipfile.ZipFile(path).namelist()
