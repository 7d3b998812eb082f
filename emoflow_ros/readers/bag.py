"""Reader of bags: the event topic, and the camera_info and the IMU beside it."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.bag_camera import camera_beside
from emoflow_ros.readers.bag_events import TopicDecoder, choose_events
from emoflow_ros.readers.bag_files import open_bag, read_messages
from emoflow_ros.readers.bag_folder import is_bag
from emoflow_ros.readers.bag_imu import choose_imu, read_imu
from emoflow_ros.readers.reader_base import ANY_SIZE, Imu, read_camera, trimmed
from emoflow_ros.readers.stream_check import StreamCheck
from msg_adapters import DecodeError, EventMessage
from msg_adapters.formats import event_array

# The times of these types do not depend on earlier messages.
_STANDALONE = event_array.TYPES

_SLACK_S = (1, 10, 100)  # log times follow event times at about a constant distance


class BagRecording:
    """The event topic of a bag, with the camera_info beside it."""

    FORMAT = "a bag (ROS 1 .bag, rosbag2 folder, .mcap, .db3)"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        self.path = path
        with ExitStack() as stack:
            self._bag = stack.enter_context(open_bag(path))
            self._connections = choose_events(path, self._bag, topic)
            self.topic = self._connections[0].topic
            self.camera = (
                read_camera(calibration)
                if calibration
                else camera_beside(path, self._bag, self.topic)
            )
            self.duration: float | None = self._bag.duration / NS_PER_S
            self.check: StreamCheck | None = None
            self._stack = stack.pop_all()

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path looks like a bag: by its name or first bytes, or a folder's files."""
        return is_bag(path)

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, one message at a time."""
        start = None
        if since is not None and all(c.msgtype in _STANDALONE for c in self._connections):
            start = _log_time_before(since, self._first_event)
        return trimmed(self._checked(start), since)

    def _checked(self, start: int | None) -> Iterator[Events]:
        check: StreamCheck | None = None
        for _, message in self._decode(start):
            if check is None:
                size = self._sensor_size(message.width, message.height)
                self.check = check = StreamCheck(self.path, *size)
            yield check(message.events, message.dropped_outside)
        if check is None:
            raise InputError(self.path, f"no messages on {self.topic}", "record it again")
        yield check.finish()

    def _decode(self, start: int | None) -> Iterator[tuple[int, EventMessage]]:
        """Decode the messages logged at or after a time in ns, each with its log time."""
        decoder = TopicDecoder(self._connections)
        for connection, logged, data in read_messages(
            self.path, self._bag, self._connections, start
        ):
            try:
                yield logged, decoder.decode(connection, data)
            except DecodeError as error:
                raise InputError(
                    self.path, f"damaged message on {self.topic} ({error})", "record it again"
                ) from None

    def _first_event(self, start: int | None) -> tuple[int, int] | None:
        """Log and latest event time of the first events logged at or after a time, ns.

        The latest, since a single one may be too early.
        """
        for logged, message in self._decode(start):
            if len(message.events):
                return logged, int(message.events.t.max())
        return None

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read an IMU topic; see Recording."""
        connections = choose_imu(self.path, self._bag.connections, self.topic, topic)
        if not connections:
            return None
        return read_imu(self.path, read_messages(self.path, self._bag, connections))

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
