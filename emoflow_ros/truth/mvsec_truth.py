"""Ground truth in MVSEC's files.

`<sequence>_gt.hdf5` has poses, depth and flow of the left camera. `<sequence>_gt_flow_dist.npz` has
flow maps, and `<sequence>_odom.npz` the data set's own, smoothed velocities.
"""

import zipfile
from contextlib import ExitStack
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.hdf5 import holds, open_hdf5, refuse
from emoflow_ros.readers.numpy_damage import damage_as_value_error
from emoflow_ros.readers.stamps import distinct
from emoflow_ros.truth.flow_maps import DepthFlowMaps, FlowMaps, PropagatedFlow
from emoflow_ros.truth.ground_truth import PoseTrack, PoseTwist, TrueTwist, Truth

_GROUP = "davis/left"
_POSE = f"{_GROUP}/pose"
_DEPTH = f"{_GROUP}/depth_image_raw"
_FLOW = f"{_GROUP}/flow_dist"
_FLOW_FIX = "give MVSEC's <sequence>_gt_flow_dist.npz"
_FLOW_PARTS = ("timestamps", "x_flow_dist", "y_flow_dist")
_ODOMETRY_FIX = "give MVSEC's <sequence>_odom.npz"


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
        """Return None: the file does not say what moves."""
        return None


def _read_track(path: Path, file: h5py.File) -> PoseTrack:
    poses = file[_POSE][:].astype(np.float64)
    stamps = _stamps(file, _POSE)
    if poses.shape != (len(stamps), 4, 4):
        raise InputError(path, f"{_POSE} of shape {poses.shape}", "give MVSEC's *_gt.hdf5")
    order = np.argsort(stamps, kind="stable")
    kept = order[distinct(f"{path} {_POSE}", stamps[order])]
    stamps, poses = stamps[kept], poses[kept]
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


class MvsecFlowMaps:
    """Maps over the interval to the next stamp, in the distorted image.

    The arrays of a sequence take up to 16 GB: they are read map by map. A step forward costs
    nothing, a step back decompresses the archive from its start. The simulator's files have a
    further array `moving` (N, H, W): which pixels see a moving object.

    Raises:
        InputError: not such a file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.name = path.name
        try:
            with damage_as_value_error():
                with zipfile.ZipFile(path) as archive, archive.open("timestamps.npy") as file:
                    seconds = np.lib.format.read_array(file)
                    told = "moving.npy" in archive.namelist()
                self._columns = [_ArchivedImages(path, f"{part}.npy") for part in _FLOW_PARTS[1:]]
                self._moving = _ArchivedImages(path, "moving.npy") if told else None
        except (OSError, KeyError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(path, f"not a flow ground truth ({reason})", _FLOW_FIX) from None
        self.stamps = np.rint(seconds.astype(np.float64) * NS_PER_S).astype(np.int64)
        if self._columns[0].shape != self._columns[1].shape or len(self.stamps) != len(
            self._columns[0]
        ):
            raise InputError(path, f"{', '.join(_FLOW_PARTS)} differ in length", _FLOW_FIX)

    def read(self, index: int) -> NDArray[np.float32]:
        """Read map `index`, (H, W, 2) px; 0 where unknown."""
        return np.stack([self._read(column, index) for column in self._columns], axis=-1)

    def moving(self, index: int) -> NDArray[np.bool_] | None:
        """Read which pixels (H, W) see an object of its own motion; None if that is unknown."""
        return None if self._moving is None else self._read(self._moving, index) != 0

    def _read(self, frames: "_ArchivedImages", index: int) -> NDArray[np.float32]:
        try:
            with damage_as_value_error():
                return frames.read(index)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(self._path, f"damaged ({reason})", "download it again") from None


class _ArchivedImages:
    """One (N, H, W) array of an archive, read frame by frame."""

    def __init__(self, path: Path, member: str) -> None:
        # An archive of its own: members of one archive disturb each other when they seek.
        self._archive = zipfile.ZipFile(path)
        self._stream = self._archive.open(member)
        major, _ = np.lib.format.read_magic(self._stream)
        if major == 1:
            header = np.lib.format.read_array_header_1_0(self._stream)
        else:
            header = np.lib.format.read_array_header_2_0(self._stream)
        self.shape, fortran_order, self._dtype = header
        if len(self.shape) != 3 or fortran_order:
            raise ValueError(f"{member} of shape {self.shape} is not a stack of images")
        self._start = self._stream.tell()
        self._bytes = self.shape[1] * self.shape[2] * self._dtype.itemsize

    def __len__(self) -> int:
        return int(self.shape[0])

    def read(self, index: int) -> NDArray[np.float32]:
        """Read frame `index`, (H, W)."""
        self._stream.seek(self._start + index * self._bytes)
        data = np.frombuffer(self._stream.read(self._bytes), self._dtype)
        return data.reshape(self.shape[1:]).astype(np.float32)


class SmoothedOdometry:
    """Velocities as the file has them, in the left camera's frame, linear between its stamps.

    They are differences of consecutive poses, smoothed by a mean over 21 of them. The mean was
    taken in place: the ten values before each are smoothed already. At 20 frames per second, 28 %
    of a 1 Hz oscillation are left, 0.2 s early. The velocities serve comparison with figures that
    were computed from them. The file's orientations are not usable, since all four components were
    written to one column: it gives no poses.

    Raises:
        InputError: not such a file.
    """

    name = "MVSEC's odometry"

    def __init__(self, path: Path) -> None:
        try:
            with damage_as_value_error(), np.load(path) as archive:
                seconds, linear, angular = (
                    np.asarray(archive[key], np.float64)
                    for key in ("timestamps", "lin_vel", "ang_vel")
                )
        except (OSError, KeyError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(path, f"not an odometry file ({reason})", _ODOMETRY_FIX) from None
        count = len(seconds)
        if seconds.shape != (count,) or {linear.shape, angular.shape} != {(count, 3)}:
            raise InputError(
                path, "timestamps, lin_vel and ang_vel differ in length", _ODOMETRY_FIX
            )
        stamps = np.rint(seconds * NS_PER_S).astype(np.int64)
        kept = distinct(path, stamps)
        self.stamps = stamps[kept]
        self._values = np.hstack([angular, linear])[kept]
        self.description = (
            f"velocity: {path.name}, smoothed by the data set (recursive mean over 21 frames), "
            "linear between its stamps"
        )

    def twist(self, t: int) -> TrueTwist | None:
        """Velocity at time t (ns); None outside the stamps."""
        stamps = self.stamps
        if len(stamps) < 2 or not stamps[0] <= t <= stamps[-1]:
            return None
        after = int(np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1))
        share = (t - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        value: NDArray[np.float64] = (1 - share) * self._values[after - 1]
        value = value + share * self._values[after]
        return TrueTwist(angular=value[:3], linear=value[3:])
