"""What every reader offers, and what all readers share."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.calibration import load_calibration
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError, say
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.stream_check import StreamCheck

# Of an unknown sensor: coordinates are 16-bit, and the largest one stands for all outside.
ANY_SIZE = int(np.iinfo(np.uint16).max)


@dataclass(frozen=True)
class Imu:
    """Readings of one IMU.

    Attributes:
        name: the topic or the file's name.
        t: (N,) int64 ns, in the order of the recording.
        angular: (N, 3) rad/s.
        acceleration: (N, 3) m/s^2, specific force; None where the IMU has no accelerometer.
    """

    name: str
    t: NDArray[np.int64]
    angular: NDArray[np.float64]
    acceleration: NDArray[np.float64] | None

    def __len__(self) -> int:
        return len(self.t)

    @property
    def rate(self) -> float:
        """Readings per second, by the median time between two; NaN with fewer than two."""
        if len(self.t) < 2:
            return float("nan")
        step = float(np.median(np.diff(self.t)))
        return NS_PER_S / step if step > 0 else float("nan")


class Recording(Protocol):
    """An opened recording of one event camera. Use as a context manager.

    Attributes:
        path: the file or folder.
        topic: the event topic or data set inside it; empty where there is only one.
        camera: the calibrated camera; None where neither the recording nor a file gives one.
        duration: length in seconds, for progress; None where only reading would tell.
        check: of the latest reading of events; None before the first.
    """

    path: Path
    topic: str
    camera: Camera | None
    duration: float | None
    check: StreamCheck | None

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events in order of time, in chunks that fit in memory.

        Single events that are not in order are left out and counted, see `EventOrder`.

        Args:
            since: leave out the events before this time, ns. Formats that can be entered in the
                middle are not read from the start then.

        Raises:
            InputError: damaged data, times that go back for good, events outside the sensor.
        """
        ...

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read the readings of the recording's IMU.

        Args:
            topic: the IMU's topic in a bag; by default `imu` beside the event topic, or the only
                one.

        Returns:
            The readings; None where the recording has no IMU.

        Raises:
            InputError: damaged data, no such topic, or several of which none is beside the events.
        """
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


def refuse_imu_topic(path: Path, topic: str | None) -> None:
    """Refuse an IMU topic that is given for a recording that is no bag.

    Raises:
        InputError: a topic is given.
    """
    if topic is not None:
        raise InputError(path, f"not a bag: no IMU topic '{topic}'", "leave the topic out")


def trimmed(chunks: Iterable[Events], since: int | None) -> Iterator[Events]:
    """Leave out the events before a time in ns."""
    for events in chunks:
        if since is None:
            yield events
        elif len(events) and events.t[-1] >= since:
            yield events[int(np.searchsorted(events.t, since)) :]


def read_camera(path: Path) -> Camera:
    """Read a calibration file, and say what was assumed of it.

    Raises:
        InputError: see `load_calibration`.
    """
    camera = load_calibration(path)
    if camera.note:
        say(path, camera.note)
    return camera


def require_camera(recording: Recording) -> Camera:
    """Return the recording's camera.

    Raises:
        InputError: it has no calibration.
    """
    if recording.camera is None:
        raise InputError(
            recording.path,
            "holds no camera calibration",
            "give one with --calib FILE (camera_info YAML, Kalibr, OpenCV or ECD calib.txt)",
        )
    return recording.camera


def unordered(recording: Recording) -> int:
    """How many events the latest reading of a recording has left out as not in order of time."""
    return recording.check.order.left_out if recording.check else 0


class FileRecording:
    """A single file with one stream of events; a subclass opens it and yields its events.

    Attributes:
        options: what the user says of columns that do not say it themselves.
        file_name: of the file that holds the events.
        named: the file that errors name.
        stack: closes what the subclass opens.
        size: (width, height) as the file gives it; (0, 0) where it gives none.
    """

    def __init__(
        self,
        path: Path,
        *,
        topic: str | None = None,
        calibration: Path | None = None,
        columns: ColumnOptions | None = None,
    ) -> None:
        if topic is not None:
            raise InputError(path, "a file of one stream has no topics", "leave --topic out")
        self.path = path
        self.topic = ""
        self.file_name = path.name
        self.named = path
        self.camera = read_camera(calibration) if calibration else None
        self.duration: float | None = None
        self.check: StreamCheck | None = None
        self.size = (0, 0)
        self.options = columns or ColumnOptions()
        self.stack = ExitStack()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stack.close()

    def imu(self, topic: str | None = None) -> Imu | None:
        """Return None; see Recording. Formats that hold an IMU override it."""
        refuse_imu_topic(self.path, topic)
        return None

    def checked(self, chunks: Iterable[Events], since: int | None = None) -> Iterator[Events]:
        """Pass the events from a time on, checked against the sensor's size and for order.

        Raises:
            InputError: the calibration is of another size, or see StreamCheck.
        """
        self.check = check = StreamCheck(self.named, *self._sensor_size())
        yield from trimmed(map(check, chunks), since)
        yield from trimmed([check.finish()], since)

    def _sensor_size(self) -> tuple[int, int]:
        if self.camera is None:
            return self.size if all(self.size) else (ANY_SIZE, ANY_SIZE)
        size = self.camera.width, self.camera.height
        if all(self.size) and self.size != size:
            raise InputError(
                self.named,
                f"events of a {self.size[0]}x{self.size[1]} sensor with the calibration of a "
                f"{size[0]}x{size[1]} one",
                "give this sensor's calibration with --calib FILE",
            )
        return size
