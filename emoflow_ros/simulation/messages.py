"""ROS messages as bytes, in ROS 1 and in CDR serialisation; events without per-event objects."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events

EVENT_ARRAY = "dvs_msgs/msg/EventArray"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMU = "sensor_msgs/msg/Imu"
IMAGE = "sensor_msgs/msg/Image"
POSE = "geometry_msgs/msg/PoseStamped"

OPTICAL_FRAME = "davis_left_optical"
IMU_FRAME = "davis_left_imu"
WORLD_FRAME = "world"

_EVENT_MSG = "uint16 x\nuint16 y\n{time} ts\nbool polarity\n"
_EVENT_ARRAY_MSG = "std_msgs/Header header\nuint32 height\nuint32 width\ndvs_msgs/Event[] events\n"
_ROS1_RECORD = np.dtype(
    [("x", "<u2"), ("y", "<u2"), ("sec", "<u4"), ("nanosec", "<u4"), ("polarity", "u1")]
)
_CDR_RECORD = np.dtype(
    {
        "names": ["x", "y", "sec", "nanosec", "polarity"],
        "formats": ["<u2", "<u2", "<i4", "<u4", "u1"],
        "offsets": [0, 2, 6, 10, 14],
        "itemsize": 16,
    }
)
# A point of a cloud: its time counts from the message's stamp.
_POINT = np.dtype([("x", "<u2"), ("y", "<u2"), ("t_ns", "<u4"), ("p", "u1")])
# Name, offset and type of each member, as in sensor_msgs/PointField.
_POINT_FIELDS = (("x", 0, 4), ("y", 2, 4), ("t_ns", 4, 6), ("p", 8, 2))


@dataclass(frozen=True)
class ImuSample:
    """Angular velocity (3,) rad/s and specific force (3,) m/s^2 in the IMU's axes."""

    angular: NDArray[np.float64]
    force: NDArray[np.float64]


class MessageEncoder:
    """Builds and serialises the messages of a recording.

    Args:
        ros1: ROS 1 serialisation and types, otherwise ROS 2's CDR, little endian.
        event_type: EVENT_ARRAY or POINT_CLOUD.
    """

    def __init__(self, *, ros1: bool, event_type: str = EVENT_ARRAY) -> None:
        self.ros1 = ros1
        self.event_type = event_type
        self.typestore = _typestore(ros1)
        self._types: dict[str, Any] = dict(self.typestore.types)
        self._record = _ROS1_RECORD if ros1 else _CDR_RECORD

    def events(self, stamp: int, camera: Camera, events: Events) -> bytes:
        """Message of `event_type`; stamp in ns, at the first event or less than 4 s before it."""
        if self.event_type == POINT_CLOUD:
            return self._point_cloud(stamp, events)
        empty = self._types[EVENT_ARRAY](
            self._header(stamp, OPTICAL_FRAME), camera.height, camera.width, []
        )
        body = _ros1_records(events) if self.ros1 else _cdr_records(events)
        # A message without events ends in their count.
        count = len(events).to_bytes(4, "little")
        return self._serialize(empty, EVENT_ARRAY)[:-4] + count + body

    def _point_cloud(self, stamp: int, events: Events) -> bytes:
        points = np.empty(len(events), _POINT)
        points["x"], points["y"], points["p"] = events.x, events.y, events.p
        points["t_ns"] = events.t - stamp
        field = self._types["sensor_msgs/msg/PointField"]
        cloud = self._types[POINT_CLOUD](
            header=self._header(stamp, OPTICAL_FRAME),
            height=1,
            width=len(points),
            fields=[field(name, offset, kind, 1) for name, offset, kind in _POINT_FIELDS],
            is_bigendian=False,
            point_step=_POINT.itemsize,
            row_step=points.nbytes,
            data=points.view(np.uint8),
            is_dense=True,
        )
        return self._serialize(cloud, POINT_CLOUD)

    def camera_info(self, stamp: int, camera: Camera) -> bytes:
        """sensor_msgs/CameraInfo; P is K, so the rectified image keeps the intrinsics."""
        k = camera.intrinsic_matrix
        model, coefficients = ros_distortion(camera)
        projection = np.hstack([k, np.zeros((3, 1))])
        roi = self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        matrices = {"d": np.array(coefficients), "k": k, "r": np.eye(3), "p": projection}
        info = self._types[CAMERA_INFO](
            header=self._header(stamp, OPTICAL_FRAME),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            binning_x=0,
            binning_y=0,
            roi=roi,
            **{name.upper() if self.ros1 else name: m.ravel() for name, m in matrices.items()},
        )
        return self._serialize(info, CAMERA_INFO)

    def imu(self, stamp: int, sample: ImuSample) -> bytes:
        """sensor_msgs/Imu without orientation (its covariance starts with -1)."""
        quaternion = self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        no_orientation = np.zeros(9)
        no_orientation[0] = -1
        message = self._types[IMU](
            self._header(stamp, IMU_FRAME),
            quaternion,
            no_orientation,
            self._vector("Vector3", sample.angular),
            np.zeros(9),
            self._vector("Vector3", sample.force),
            np.zeros(9),
        )
        return self._serialize(message, IMU)

    def depth_image(self, stamp: int, depth: NDArray[np.float64]) -> bytes:
        """sensor_msgs/Image 32FC1 of depths (H, W) in m."""
        height, width = depth.shape
        data = depth.astype("<f4").view(np.uint8).ravel()
        header = self._header(stamp, OPTICAL_FRAME)
        message = self._types[IMAGE](header, height, width, "32FC1", 0, 4 * width, data)
        return self._serialize(message, IMAGE)

    def pose(self, stamp: int, transform: NDArray[np.float64]) -> bytes:
        """geometry_msgs/PoseStamped of world-from-camera (4, 4)."""
        quaternion = Rotation.from_matrix(transform[:3, :3]).as_quat()
        orientation = self._types["geometry_msgs/msg/Quaternion"](*map(float, quaternion))
        position = self._vector("Point", transform[:3, 3])
        pose = self._types["geometry_msgs/msg/Pose"](position, orientation)
        return self._serialize(self._types[POSE](self._header(stamp, WORLD_FRAME), pose), POSE)

    def _vector(self, kind: str, values: NDArray[np.float64]) -> Any:
        return self._types[f"geometry_msgs/msg/{kind}"](*map(float, values))

    def _header(self, stamp: int, frame: str) -> Any:
        time = self._types["builtin_interfaces/msg/Time"](*divmod(stamp, NS_PER_S))
        fields = {"stamp": time, "frame_id": frame}
        if self.ros1:
            fields["seq"] = 0
        return self._types["std_msgs/msg/Header"](**fields)

    def _serialize(self, message: Any, name: str) -> bytes:
        store = self.typestore
        return bytes(
            store.serialize_ros1(message, name) if self.ros1 else store.serialize_cdr(message, name)
        )


def _ros1_records(events: Events) -> bytes:
    return _fill(np.empty(len(events), _ROS1_RECORD), events).tobytes()


def _cdr_records(events: Events) -> bytes:
    """Pack events as a CDR sequence of dvs_msgs/Event.

    CDR aligns each member, not the struct: x of every event but the first comes one byte of
    padding after the polarity before it, and `ts` needs two more. The records below therefore
    start 2 bytes before the first event, whose x and y have no such gap behind them.
    """
    packed = bytearray(_fill(np.zeros(len(events), _CDR_RECORD), events).tobytes()[2:-1])
    packed[:4] = np.concatenate([events.x[:1], events.y[:1]]).astype("<u2").tobytes()
    return bytes(packed)


def _fill(records: NDArray[np.void], events: Events) -> NDArray[np.void]:
    records["x"], records["y"], records["polarity"] = events.x, events.y, events.p
    records["sec"], records["nanosec"] = np.divmod(events.t, NS_PER_S)
    return records


def ros_distortion(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """Name and coefficients as CameraInfo writes them: no lens is a plumb_bob of zeros."""
    if camera.model == "none":
        return "plumb_bob", (0.0,) * 5
    return camera.model, camera.distortion


def _typestore(ros1: bool) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    time = "time" if ros1 else "builtin_interfaces/Time"
    store.register(get_types_from_msg(_EVENT_MSG.format(time=time), "dvs_msgs/msg/Event"))
    store.register(get_types_from_msg(_EVENT_ARRAY_MSG, EVENT_ARRAY))
    return store
