"""The IMU topics of a bag.

The messages are viewed as bytes, since a recording may hold millions of them.
"""

import struct
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_files import serialization
from emoflow_ros.readers.reader_base import Imu

IMU_TYPE = "sensor_msgs/msg/Imu"
# After the header: orientation (4), angular velocity (3) and acceleration (3), each with its
# covariance (9) behind it.
_VALUES = 37
_ANGULAR, _ANGULAR_COVARIANCE = slice(13, 16), 16
_ACCELERATION, _ACCELERATION_COVARIANCE = slice(25, 28), 28
_NOT_MEASURED = -1.0  # in the first element of a covariance
_ENCAPSULATION = 4
_STAMP = 4  # offset in CDR and, after the sequence number, in ROS 1


def choose_imu(
    path: Path, connections: Sequence[Connection], beside: str, topic: str | None
) -> list[Connection]:
    """Find the IMU topic asked for, the one `imu` beside the events, or the only one.

    Args:
        path: of the bag, for errors.
        connections: the bag's.
        beside: the event topic.
        topic: the one asked for.

    Returns:
        Its connections; none where the bag has no IMU and none was asked for.

    Raises:
        InputError: no such topic, or several of which none is beside the events.
    """
    known = sorted({c.topic for c in connections if c.msgtype == IMU_TYPE})
    own = beside.rpartition("/")[0] + "/imu"
    chosen = topic or (own if own in known else known[0] if len(known) == 1 else None)
    there = ", ".join(known) or "none"
    if chosen is None and known:
        raise InputError(path, f"{len(known)} IMU topics: {there}", "name the camera's")
    if chosen is not None and chosen not in known:
        raise InputError(path, f"no {IMU_TYPE} topic '{chosen}'", f"its IMU topics: {there}")
    return [c for c in connections if c.topic == chosen]


def read_imu(path: Path, messages: Iterable[tuple[Connection, int, bytes]]) -> Imu:
    """Read all messages of an IMU topic, as `read_messages` gives them.

    Raises:
        InputError: no messages, damaged messages, or messages that say there is no gyroscope.
    """
    topic = ""
    stamps, rows = [], []
    for connection, _, data in messages:
        topic = connection.topic
        try:
            stamp, values = _parse_imu(data, ros2=serialization(connection) == "cdr")
        except (IndexError, struct.error, ValueError):
            raise InputError(path, f"damaged message on {topic}", "record it again") from None
        stamps.append(stamp)
        rows.append(values)
    if not rows:
        raise InputError(path, "its IMU topic has no messages", "record it again")
    table = np.array(rows, np.float64)
    if table[0, _ANGULAR_COVARIANCE] == _NOT_MEASURED:
        raise InputError(path, f"{topic} says that it has no gyroscope", "name another topic")
    has_force = table[0, _ACCELERATION_COVARIANCE] != _NOT_MEASURED
    return Imu(
        topic,
        np.array(stamps, np.int64),
        table[:, _ANGULAR].copy(),
        table[:, _ACCELERATION].copy() if has_force else None,
    )


def header_stamp(data: bytes, *, ros2: bool) -> int:
    """Return the stamp in ns of a serialised message that begins with a header.

    Raises:
        struct.error, IndexError: it is too short.
    """
    sec, nanosec, _ = struct.unpack_from(f"{_byte_order(data, ros2)}iII", data, _STAMP)
    return int(sec) * NS_PER_S + int(nanosec)


def _parse_imu(data: bytes, *, ros2: bool) -> tuple[int, NDArray[np.float64]]:
    """Return a message's stamp in ns and its 37 numbers."""
    order = _byte_order(data, ros2)
    (length,) = struct.unpack_from(f"{order}I", data, _STAMP + 8)
    start = _STAMP + 12 + length
    if ros2:  # aligned to 8 bytes, counted from after the encapsulation
        start += -(start - _ENCAPSULATION) % 8
    values = np.frombuffer(data, f"{order}f8", _VALUES, start)
    return header_stamp(data, ros2=ros2), values


def _byte_order(data: bytes, ros2: bool) -> str:
    return "<" if not ros2 or data[1] & 1 else ">"
