"""What the readers of single files with one stream of events share."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from emoflow_ros.core.calibration import load_calibration
from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.base import StreamCheck, refuse_imu_topic, trimmed
from emoflow_ros.offline.readers.imu import Imu

_ANY_SIZE = 1 << 16  # of an unknown sensor: coordinates are 16-bit


class FileRecording:
    """One file; a subclass opens it and yields its events.

    Attributes:
        file_name: of the file that holds the events.
        stack: closes what the subclass opens.
        size: (width, height) as the file gives it; (0, 0) where it gives none.
    """

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        if topic is not None:
            raise InputError(path, "a file of one stream has no topics", "leave --topic out")
        self.path = path
        self.topic = ""
        self.file_name = path.name
        self.camera = load_calibration(calibration) if calibration else None
        self.duration: float | None = None
        self.size = (0, 0)
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
        """Return nothing: see Recording. Formats that hold an IMU override it."""
        refuse_imu_topic(self.path, topic)
        return None

    def checked(self, chunks: Iterable[Events], since: int | None = None) -> Iterator[Events]:
        """Pass the events from a time on, checked against the sensor's size and for order.

        Raises:
            InputError: the calibration is of another size, or see StreamCheck.
        """
        check = StreamCheck(self.path, *self._sensor_size())
        yield from trimmed(map(check, chunks), since)
        check.finish()

    def _sensor_size(self) -> tuple[int, int]:
        if self.camera is None:
            return self.size if all(self.size) else (_ANY_SIZE, _ANY_SIZE)
        size = self.camera.width, self.camera.height
        if all(self.size) and self.size != size:
            raise InputError(
                self.path,
                f"events of a {self.size[0]}x{self.size[1]} sensor with the calibration of a "
                f"{size[0]}x{size[1]} one",
                "give this sensor's calibration with --calib FILE",
            )
        return size
