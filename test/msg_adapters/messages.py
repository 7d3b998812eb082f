"""Serialised messages for the tests, written by rosbags: a reference independent of our code."""

from functools import cache

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from emoflow_ros.core.types.events import Events

NS_PER_S = 1_000_000_000
PACKAGES = ("dvs_msgs", "prophesee_event_msgs", "dv_ros_msgs", "dv_ros2_msgs")

_EVENT = "uint16 x\nuint16 y\n{time} ts\nbool polarity"
_EVENT_ARRAY = "std_msgs/Header header\nuint32 height\nuint32 width\n{package}/Event[] events"
_EVENT_PACKET = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
    "string encoding\nbool is_bigendian\nuint8[] events"
)
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


@cache
def typestore(serialization: str) -> Typestore:
    """The standard types with those of the event camera packages."""
    ros2 = serialization == "cdr"
    store = get_typestore(Stores.ROS2_JAZZY if ros2 else Stores.ROS1_NOETIC)
    types = get_types_from_msg(_EVENT_PACKET, "event_camera_msgs/msg/EventPacket")
    for package in PACKAGES:
        event = _EVENT.format(time="builtin_interfaces/Time" if ros2 else "time")
        types |= get_types_from_msg(event, f"{package}/msg/Event")
        types |= get_types_from_msg(
            _EVENT_ARRAY.format(package=package), f"{package}/msg/EventArray"
        )
    store.register(types)
    return store


def serialize(message: object, serialization: str, little_endian: bool = True) -> bytes:
    store, name = typestore(serialization), message.__msgtype__
    if serialization == "cdr":
        return bytes(store.serialize_cdr(message, name, little_endian=little_endian))
    return bytes(store.serialize_ros1(message, name))


def header(serialization: str, stamp: int = 0, frame_id: str = "camera") -> object:
    types = typestore(serialization).types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp, NS_PER_S))
    seq = {} if serialization == "cdr" else {"seq": 5}
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **seq)


def event_array(
    events: Events,
    serialization: str,
    *,
    package: str = "dvs_msgs",
    size: tuple[int, int] = (346, 260),
    stamp: int = 0,
    frame_id: str = "camera",
    little_endian: bool = True,
) -> bytes:
    types = typestore(serialization).types
    event, time = types[f"{package}/msg/Event"], types["builtin_interfaces/msg/Time"]
    rows = zip(
        events.x.tolist(), events.y.tolist(), events.t.tolist(), events.p.tolist(), strict=True
    )
    message = types[f"{package}/msg/EventArray"](
        header(serialization, stamp, frame_id),
        height=size[1],
        width=size[0],
        events=[event(x, y, time(*divmod(t, NS_PER_S)), p) for x, y, t, p in rows],
    )
    return serialize(message, serialization, little_endian)


def event_packet(
    payload: bytes,
    encoding: str,
    serialization: str = "cdr",
    *,
    size: tuple[int, int] = (346, 260),
    seq: int = 0,
    time_base: int = 0,
    big_endian: bool = False,
    stamp: int = 0,
    frame_id: str = "camera",
) -> bytes:
    message = typestore(serialization).types["event_camera_msgs/msg/EventPacket"](
        header(serialization, stamp, frame_id),
        height=size[1],
        width=size[0],
        seq=seq,
        time_base=time_base,
        encoding=encoding,
        is_bigendian=big_endian,
        events=np.frombuffer(payload, np.uint8),
    )
    return serialize(message, serialization)


def point_cloud(
    points: np.ndarray,
    serialization: str = "cdr",
    *,
    stamp: int = 0,
    rows: int = 1,
    row_padding: int = 0,
) -> bytes:
    """A cloud of the fields of a structured array; all of one byte order."""
    types = typestore(serialization).types
    field = types["sensor_msgs/msg/PointField"]
    names = [(n, *points.dtype.fields[n][:2]) for n in points.dtype.names]
    big_endian = any(dtype.byteorder == ">" for _, dtype, _ in names)
    width = len(points) // rows
    data = points.view(np.uint8).reshape(rows, -1)
    data = np.pad(data, ((0, 0), (0, row_padding)), constant_values=0xAB)
    message = types["sensor_msgs/msg/PointCloud2"](
        header(serialization, stamp),
        height=rows,
        width=width,
        fields=[field(n, offset, DATATYPES[d.str[1:]], 1) for n, d, offset in names],
        is_bigendian=big_endian,
        point_step=points.dtype.itemsize,
        row_step=data.shape[1],
        data=data.reshape(-1),
        is_dense=True,
    )
    return serialize(message, serialization)
