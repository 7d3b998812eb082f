"""Ground truth from a bag: poses and, where there are depth images, flow."""

from contextlib import ExitStack
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_files import Bag, deserialize, open_bag, read_messages
from emoflow_ros.readers.stamps import distinct
from emoflow_ros.truth.flow_maps import DepthFlowMaps, PropagatedFlow
from emoflow_ros.truth.ground_truth import TAKEN_AS_CAMERA, PoseTrack, PoseTwist, Truth, pose_track

_ODOMETRY = "nav_msgs/msg/Odometry"
POSE_TYPES = ("geometry_msgs/msg/PoseStamped", _ODOMETRY)  # the best first
_POSE_NAME = "pose"  # of the camera's own topic
IMAGE = "sensor_msgs/msg/Image"
# On the event camera's own (distorted) pixel grid; and without distortion, with the same K.
DEPTH_NAMES = ("depth_image_raw", "depth_image_rect")


def load_bag_truth(path: Path, camera: Camera, namespace: str) -> Truth:
    """Read poses of any name, and depth in MVSEC's layout, `<camera>/depth_image_*`.

    Args:
        path: a bag of any kind.
        camera: the event camera.
        namespace: the camera's topic prefix, for example `/davis/left`, to choose between
            several cameras.

    Raises:
        InputError: a bag without poses, or with several topics of which none is the camera's.
    """
    stack = ExitStack()  # depth images are read when they are needed: they keep the bag open
    reader = stack.enter_context(open_bag(path))
    topic = _choose_poses(path, reader, namespace)
    track, note = _read_track(path, reader, [c for c in reader.connections if c.topic == topic])
    twists = PoseTwist(track, f"{path.name}{topic}", note)
    depth = _choose(path, reader, namespace, IMAGE, DEPTH_NAMES)
    if depth is None:
        stack.close()
        return Truth(twists, poses=track)
    images = _DepthImages(path, reader, depth, camera, stack)
    maps = DepthFlowMaps(camera, track, images.stamps, images.read, f"{path.name}{depth.topic}")
    return Truth(twists, PropagatedFlow(maps), poses=track)


def _choose_poses(path: Path, reader: Bag, namespace: str) -> str:
    """Choose the camera's topic `pose`, or the only one that the first of these rules leaves.

    Topics named `pose`; those in the camera's namespace; PoseStamped; Odometry.
    """
    types = {c.topic: c.msgtype for c in reader.connections if c.msgtype in POSE_TYPES}
    if not types:
        there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections}))
        raise InputError(
            path,
            f"no {' or '.join(POSE_TYPES)} topic; it holds {there or 'no topics'}",
            "give a ground-truth bag",
        )
    if f"{namespace}/{_POSE_NAME}" in types:
        return f"{namespace}/{_POSE_NAME}"
    rules = (
        [t for t in types if t.rpartition("/")[2] == _POSE_NAME],
        [t for t in types if t.startswith(f"{namespace}/")],
        *([t for t in types if types[t] == kind] for kind in POSE_TYPES),
    )
    found = next(topics for topics in rules if topics)
    if len(found) == 1:
        return found[0]
    raise InputError(
        path,
        f"several of {', '.join(sorted(found))}",
        "give a bag with one of them only",
    )


def _choose(
    path: Path, reader: Bag, namespace: str, kind: str, names: tuple[str, ...]
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


def _read_track(path: Path, reader: Bag, connections: list[Connection]) -> tuple[PoseTrack, str]:
    """Read the poses of a topic, and say whose they are, unless it is the camera's own."""
    rows = []
    note = "" if connections[0].topic.endswith(f"/{_POSE_NAME}") else TAKEN_AS_CAMERA
    for connection, _, data in read_messages(path, reader, connections):
        message = deserialize(reader, connection, data)
        pose = message.pose
        if connection.msgtype == _ODOMETRY:
            pose = pose.pose
            note = f"poses of '{message.child_frame_id}' {TAKEN_AS_CAMERA}"
        p, q = pose.position, pose.orientation
        rows.append((_stamp(message), (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)))
    if not rows:
        raise InputError(path, f"no messages on {connections[0].topic}", "record it again")
    stamps, positions, quaternions = zip(*sorted(rows, key=itemgetter(0)), strict=True)
    kept = distinct(f"{path} {connections[0].topic}", np.array(stamps, np.int64))
    track = pose_track(
        path,
        np.array(stamps, np.int64)[kept],
        np.array(positions, np.float64)[kept],
        np.array(quaternions, np.float64)[kept],
    )
    return track, note


class _DepthImages:
    """The depth images of a topic, found by index in the bag when they are needed."""

    def __init__(
        self,
        path: Path,
        reader: Bag,
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
