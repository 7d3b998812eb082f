"""Ground truth of MVSEC's `<sequence>_gt.hdf5`: poses, depth and flow of the left camera."""

from contextlib import ExitStack
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import Truth
from emoflow_ros.offline.truth.depth import DepthFlowMaps
from emoflow_ros.offline.truth.flow_maps import FlowMaps, PropagatedFlow
from emoflow_ros.offline.truth.poses import PoseTrack, PoseTwist
from emoflow_ros.readers.hdf5 import holds, open_hdf5, refuse

_GROUP = "davis/left"
_POSE = f"{_GROUP}/pose"
_DEPTH = f"{_GROUP}/depth_image_raw"
_FLOW = f"{_GROUP}/flow_dist"


def is_mvsec_truth(path: Path) -> bool:
    """Whether the path is a file of this format."""
    return holds(path, [_POSE, f"{_POSE}_ts"])


def load_mvsec_truth(path: Path, camera: Camera) -> Truth:
    """Read poses (velocity), and flow from `flow_dist` or else from depth and poses.

    Args:
        path: the file; it stays open, its images are read when they are needed.
        camera: the left camera.

    Raises:
        InputError: arrays of unexpected shapes.
    """
    file = ExitStack().enter_context(open_hdf5(path))
    track = _read_track(path, file)
    twists = PoseTwist(track, path.name)
    maps: FlowMaps | None = None
    size = (camera.height, camera.width)
    if _FLOW in file:
        maps = _StoredFlow(path, _images(path, file, _FLOW, (2, *size)), _stamps(file, _FLOW))
    elif _DEPTH in file:
        depth = _images(path, file, _DEPTH, size)
        maps = DepthFlowMaps(
            camera,
            track,
            _stamps(file, _DEPTH),
            lambda index: _read_depth(path, depth, index),
            f"{path.name}, depth",
        )
    return Truth(twists, PropagatedFlow(maps) if maps else None, poses=track)


class _StoredFlow:
    """Flow maps (N, 2, H, W) of the file, each to the next stamp."""

    def __init__(self, path: Path, images: h5py.Dataset, stamps: NDArray[np.int64]) -> None:
        self._path = path
        self._images = images
        self.stamps = stamps
        self.name = f"{path.name}, flow_dist"

    def read(self, index: int) -> NDArray[np.float32]:
        """Read map `index`, (H, W, 2) px; 0 where unknown."""
        return np.moveaxis(_read_image(self._path, self._images, index), 0, -1)

    def moving(self, index: int) -> NDArray[np.bool_] | None:
        """Tell nothing: the file does not say what moves."""
        return None


def _read_track(path: Path, file: h5py.File) -> PoseTrack:
    poses = file[_POSE][:].astype(np.float64)
    stamps = _stamps(file, _POSE)
    if poses.shape != (len(stamps), 4, 4):
        raise InputError(path, f"{_POSE} of shape {poses.shape}", "give MVSEC's *_gt.hdf5")
    stamps, unique = np.unique(stamps, return_index=True)
    poses = poses[unique]
    rotations = Rotation.from_matrix(poses[:, :3, :3])
    return PoseTrack(stamps, poses[:, :3, 3], rotations.as_quat())


def _stamps(file: h5py.File, name: str) -> NDArray[np.int64]:
    return np.rint(file[f"{name}_ts"][:].astype(np.float64) * NS_PER_S).astype(np.int64)


def _images(path: Path, file: h5py.File, name: str, shape: tuple[int, ...]) -> h5py.Dataset:
    images = file[name]
    if images.shape[1:] != shape:
        raise InputError(
            path, f"{name} of shape {images.shape}", f"give images of the event camera's {shape}"
        )
    return images


def _read_image(path: Path, images: h5py.Dataset, index: int) -> NDArray[np.float32]:
    try:
        return images[index].astype(np.float32)
    except OSError as error:
        refuse(path, error)


def _read_depth(path: Path, images: h5py.Dataset, index: int) -> NDArray[np.float32]:
    depth = _read_image(path, images, index)
    return np.where(depth > 0, depth, np.float32(np.nan))
