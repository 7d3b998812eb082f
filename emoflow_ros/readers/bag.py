"""Reader of bags: the event topic, the camera_info beside it and the IMU topics.

The messages of an IMU are viewed as bytes, since a recording may hold millions of them.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection

from emoflow_ros.core.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_camera import camera_beside
from emoflow_ros.readers.bag_files import (
    MAGIC,
    open_bag,
    read_messages,
    serialization,
    storage,
)
from emoflow_ros.readers.reader_base import ANY_SIZE, Imu, StreamCheck, read_camera, trimmed
from msg_adapters import DecodeError, EventMessage, make_decoder, supported_types

# The times of these types do not depend on earlier messages.
_STANDALONE = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")

_SLACK_S = (1, 10, 100)  # log times follow event times at about a constant distance
IMU_TYPE = "sensor_msgs/msg/Imu"
# After the header: orientation (4), angular velocity (3) and acceleration (3), each with its
# covariance (9) behind it.
_VALUES = 37
_ANGULAR, _ANGULAR_COVARIANCE = slice(13, 16), 16
_ACCELERATION, _ACCELERATION_COVARIANCE = slice(25, 28), 28
_NOT_MEASURED = -1.0  # in the first element of a covariance
_ENCAPSULATION = 4
_STAMP = 4  # offset in CDR and, after the sequence number, in ROS 1


class BagRecording:
    """The event topic of a bag, with the camera_info beside it."""

    FORMAT = "a bag (ROS 1 .bag, rosbag2 folder, .mcap, .db3)"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        self.path = path
        with ExitStack() as stack:
            self._bag = stack.enter_context(open_bag(path))
            self._connection = _event_connection(path, self._bag, topic)
            self.topic = self._connection.topic
            self.camera = (
                read_camera(calibration)
                if calibration
                else camera_beside(path, self._bag, self.topic)
            )
            self.duration: float | None = self._bag.duration / NS_PER_S
            self._stack = stack.pop_all()

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path looks like a bag: by its suffix, or a folder with storage files."""
        return path.suffix in MAGIC or (path / "metadata.yaml").is_file() or any(storage(path))

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, one message at a time."""
        start = None
        if since is not None and self._connection.msgtype in _STANDALONE:
            start = _log_time_before(since, self._first_event)
        return trimmed(self._checked(start), since)

    def _checked(self, start: int | None) -> Iterator[Events]:
        check: StreamCheck | None = None
        for _, message in self._decode(start):
            if check is None:
                check = StreamCheck(self.path, *self._sensor_size(message.width, message.height))
            yield check(message.events, message.dropped_outside)
        if check is None:
            raise InputError(self.path, f"no messages on {self.topic}", "record it again")
        check.finish()

    def _decode(self, start: int | None) -> Iterator[tuple[int, EventMessage]]:
        """Decode the messages logged at or after a time in ns, each with its log time."""
        decoder = make_decoder(self._connection.msgtype, serialization(self._bag))
        # Each file of a split bag without metadata has a connection of its own.
        connections = [c for c in self._bag.connections if c.topic == self.topic]
        for _, logged, data in read_messages(self.path, self._bag, connections, start):
            try:
                yield logged, decoder.decode(data)
            except DecodeError as error:
                raise InputError(
                    self.path, f"damaged message on {self.topic} ({error})", "record it again"
                ) from None

    def _first_event(self, start: int | None) -> tuple[int, int] | None:
        """Log and event time of the first event logged at or after a time, ns."""
        for logged, message in self._decode(start):
            if len(message.events):
                return logged, int(message.events.t[0])
        return None

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read an IMU topic; see Recording."""
        connections = choose_imu(self.path, self._bag.connections, self.topic, topic)
        if not connections:
            return None
        return read_imu(
            self.path, read_messages(self.path, self._bag, connections), ros2=self._bag.is2
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def _sensor_size(self, width: int, height: int) -> tuple[int, int]:
        """Reconcile the size in the messages (0: none) with the camera's."""
        if self.camera is None:
            return width or ANY_SIZE, height or ANY_SIZE
        size = self.camera.width, self.camera.height
        if width and (width, height) != size:
            raise InputError(
                self.path,
                f"events of a {width}x{height} sensor with the calibration of a "
                f"{size[0]}x{size[1]} one",
                "give this sensor's calibration with --calib FILE",
            )
        return size


def _event_connection(path: Path, reader: AnyReader, topic: str | None) -> Connection:
    """Find the one event topic, or the one asked for."""
    known = {c.topic: c for c in reader.connections if c.msgtype in supported_types()}
    if topic is not None:
        if topic in known:
            return known[topic]
        wrong = f"no event topic '{topic}'"
    elif len(known) == 1:
        return next(iter(known.values()))
    elif known:
        raise InputError(
            path, f"{len(known)} event topics: {', '.join(sorted(known))}", "choose with --topic"
        )
    else:
        wrong = "no event topic"
    there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections}))
    fix = f"give one of {', '.join(sorted(known))}" if known else "give a bag with events"
    raise InputError(path, f"{wrong}; it holds {there or 'no topics'}", fix)


def _log_time_before(
    since: int, first_event: Callable[[int | None], tuple[int, int] | None]
) -> int | None:
    """Find where to enter a bag, which is ordered by log time, to read from an event time on.

    From the log time that is found, no event at or after the event time is missed. Event times are
    in order: a first event before `since` proves that the log time is early enough.

    Args:
        since: the event time, ns.
        first_event: log and event time, ns, of the first event logged at or after a time (None:
            of all).

    Returns:
        The log time in ns; None for the bag's beginning.
    """
    first = first_event(None)
    if first is None:
        return None
    logged, time = first
    for slack_s in _SLACK_S:
        start = since + logged - time - slack_s * NS_PER_S
        if start <= logged:
            return None
        found = first_event(start)
        if found is not None and found[1] < since:
            return start
    return None


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


def read_imu(path: Path, messages: Iterable[tuple[Connection, int, bytes]], *, ros2: bool) -> Imu:
    """Read all messages of an IMU topic, as `read_messages` gives them.

    Raises:
        InputError: no messages, damaged messages, or messages that say there is no gyroscope.
    """
    topic = ""
    stamps, rows = [], []
    for connection, _, data in messages:
        topic = connection.topic
        try:
            stamp, values = _parse_imu(data, ros2=ros2)
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
