"""Ground truth from a bag: poses and, where there are depth images, flow."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.bag import deserialize, open_bag, read_messages
from emoflow_ros.offline.truth.base import Truth
from emoflow_ros.offline.truth.depth import DepthFlowMaps
from emoflow_ros.offline.truth.flow_maps import PropagatedFlow
from emoflow_ros.offline.truth.poses import PoseTrack, PoseTwist

_POSE = "geometry_msgs/msg/PoseStamped"
_IMAGE = "sensor_msgs/msg/Image"
# On the event camera's own (distorted) pixel grid; and without distortion, with the same K.
_DEPTH_NAMES = ("depth_image_raw", "depth_image_rect")


def load_bag_truth(path: Path, camera: Camera, namespace: str) -> Truth:
    """Read ground truth in MVSEC's layout: `<camera>/pose` and `<camera>/depth_image_*`.

    Args:
        path: a bag of any kind.
        camera: the event camera.
        namespace: the camera's topic prefix, for example `/davis/left`, to choose between
            several cameras.

    Raises:
        InputError: a bag without poses.
    """
    stack = ExitStack()  # depth images are read when they are needed: they keep the bag open
    reader = stack.enter_context(open_bag(path))
    poses = _choose(path, reader, namespace, _POSE, ("pose",))
    if poses is None:
        there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections}))
        raise InputError(path, f"no {_POSE} topic; it holds {there}", "give a ground-truth bag")
    track = _read_track(path, reader, poses)
    twists = PoseTwist(track, f"{path.name}{poses.topic}")
    depth = _choose(path, reader, namespace, _IMAGE, _DEPTH_NAMES)
    if depth is None:
        stack.close()
        return Truth(twists, poses=track)
    images = _DepthImages(path, reader, depth, camera, stack)
    maps = DepthFlowMaps(camera, track, images.stamps, images.read, f"{path.name}{depth.topic}")
    return Truth(twists, PropagatedFlow(maps), poses=track)


def _choose(
    path: Path, reader: AnyReader, namespace: str, kind: str, names: tuple[str, ...]
) -> Connection | None:
    """Find the topic `namespace/name`, or the only one whose last part is a name."""
    found = [c for c in reader.connections if c.msgtype == kind]
    for name in names:
        named = [c for c in found if c.topic.rpartition("/")[2] == name]
        own = [c for c in named if c.topic == f"{namespace}/{name}"]
        if own or len(named) == 1:
            return (own or named)[0]
        if named:
            topics = ", ".join(c.topic for c in named)
            raise InputError(path, f"several of {topics}", f"give the one below {namespace} only")
    return None


def _read_track(path: Path, reader: AnyReader, connection: Connection) -> PoseTrack:
    rows = []
    for _, _, data in read_messages(path, reader, [connection]):
        message = deserialize(reader, connection, data)
        p, q = message.pose.position, message.pose.orientation
        rows.append((_stamp(message), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
    if not rows:
        raise InputError(path, f"no messages on {connection.topic}", "record it again")
    stamps, positions, quaternions = zip(*sorted(rows), strict=True)
    unique = np.unique(np.array(stamps, np.int64), return_index=True)[1]
    return PoseTrack(
        np.array(stamps, np.int64)[unique],
        np.array(positions, np.float64)[unique],
        np.array(quaternions, np.float64)[unique],
    )


class _DepthImages:
    """The depth images of a topic, found by index in the bag when they are needed."""

    def __init__(
        self,
        path: Path,
        reader: AnyReader,
        connection: Connection,
        camera: Camera,
        stack: ExitStack,
    ) -> None:
        self._path, self._reader, self._connection = path, reader, connection
        self._stack = stack
        self._size = camera.height, camera.width
        is_rectified = connection.topic.endswith("_rect")
        self._pixels = _rectified_pixels(camera) if is_rectified else None
        stamps, self._log_times = [], []
        for _, log_time, data in read_messages(path, reader, [connection]):
            stamps.append(_stamp(deserialize(reader, connection, data)))
            self._log_times.append(log_time)
        self.stamps = np.array(stamps, np.int64)

    def read(self, index: int) -> NDArray[np.float32]:
        """Depth (H, W) in m on the event camera's pixel grid, NaN where unknown."""
        time = self._log_times[index]
        messages = self._reader.messages([self._connection], time, time + 1)
        _, _, data = next(messages)
        image = deserialize(self._reader, self._connection, data)
        if image.encoding != "32FC1" or (image.height, image.width) != self._size:
            raise InputError(
                self._path,
                f"depth images are {image.width}x{image.height} {image.encoding}",
                f"give 32FC1 of the event camera's size {self._size[1]}x{self._size[0]}",
            )
        order = ">f4" if image.is_bigendian else "<f4"
        rows = np.frombuffer(image.data, np.uint8).reshape(image.height, image.step)
        depth = rows[:, : 4 * image.width].copy().view(order).astype(np.float32)
        depth[~(depth > 0)] = np.nan
        if self._pixels is None:
            return depth
        padded = np.pad(depth, 1, constant_values=np.nan)
        return padded[self._pixels[1], self._pixels[0]]


def _rectified_pixels(camera: Camera) -> NDArray[np.intp]:
    """Column and row (2, H, W) of every pixel in the image without distortion, padded by one."""
    at = camera.bearings * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    limit = (camera.width, camera.height)
    pixels = np.clip(np.rint(np.nan_to_num(at, nan=-1.0)), -1, limit).astype(np.intp) + 1
    return np.moveaxis(pixels, -1, 0)


def _stamp(message: object) -> int:
    stamp = message.header.stamp  # type: ignore[attr-defined]
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
