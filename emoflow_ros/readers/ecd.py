"""Reader of the Event-Camera Dataset's folders and of its tables in text files.

The data set: Mueggler et al., IJRR 2017.
"""

from bisect import bisect_left
from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.event_columns import pixel_coordinates, to_ns
from emoflow_ros.readers.reader_base import (
    Imu,
    StreamCheck,
    read_camera,
    refuse_imu_topic,
    trimmed,
)

_EVENTS = "events.txt"
IMU_FILE = "imu.txt"
_OUTSIDE = np.iinfo(np.uint16).max
_CHUNK_BYTES = 4 << 20  # about 200 000 events
_ROW = "a line is 't x y p': seconds, pixel column, pixel row, 0 or 1"


class EcdRecording:
    """A folder with `events.txt` (`t[s] x y p`) and `calib.txt`, or its `events.txt`.

    Attributes:
        file_name: of the file that holds the events.
    """

    FORMAT = "an ECD folder or its events.txt (beside it calib.txt)"
    TYPE = "ecd/events.txt"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        if topic is not None:
            raise InputError(path, "an ECD folder has no topics", "leave --topic out")
        self.path = path if path.is_dir() else path.parent
        self.topic = ""
        own = self.path / "calib.txt"
        file = calibration or (own if own.exists() else None)
        self.camera = read_camera(file) if file else None
        self._file = self.path / _EVENTS
        self.file_name = _EVENTS
        self.duration: float | None = self._measure()

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a folder of this format, or the file in it."""
        return (path / _EVENTS).is_file() or (path.name == _EVENTS and path.is_file())

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, some 200 000 at a time."""
        return trimmed(self._read(0 if since is None else self._byte_before(since)), since)

    def _read(self, start: int) -> Iterator[Events]:
        """Read from the line on that begins at a byte."""
        camera = self.camera
        size = (camera.width, camera.height) if camera else (_OUTSIDE, _OUTSIDE)
        check = StreamCheck(self._file, *size)
        with self._file.open("rb") as lines:
            lines.seek(start)
            while text := lines.read(_CHUNK_BYTES):
                yield check(self._parse(_text(self._file, text + lines.readline())))
        check.finish()

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read `imu.txt` in the folder, where it is there; see Recording."""
        refuse_imu_topic(self.path, topic)
        file = self.path / IMU_FILE
        return read_imu_text(file) if file.is_file() else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing is held open between calls."""

    def _byte_before(self, since: int) -> int:
        """Find the start of a line before the first one at or after a time, by bisection."""
        with self._file.open("rb") as file:

            def line_after(byte: int) -> int:
                file.seek(byte)
                file.readline()
                return file.tell()

            def is_late(byte: int) -> bool:
                file.seek(line_after(byte))
                line = file.readline()
                return not line.strip() or int(self._parse(_text(self._file, line)).t[0]) >= since

            byte = bisect_left(range(self._file.stat().st_size), True, key=is_late)
            return line_after(byte - 1) if byte else 0

    def _measure(self) -> float:
        """Length in seconds from the first and the last line."""
        with self._file.open("rb") as file:
            first = file.readline()
            file.seek(max(0, self._file.stat().st_size - 4096))
            tail = file.read().splitlines()
        if not first.strip():
            raise InputError(self._file, "holds no events", "give a recording that has some")
        start, end = (self._parse(_text(self._file, line)).t for line in (first, tail[-1]))
        return float(end[0] - start[0]) / NS_PER_S

    def _parse(self, text: str) -> Events:
        try:
            rows = np.loadtxt(StringIO(text), dtype=np.float64, ndmin=2)
        except ValueError as error:
            raise InputError(self._file, f"not a table of numbers ({error})", _ROW) from None
        if rows.shape[1] != 4:
            raise InputError(self._file, f"lines of {rows.shape[1]} numbers", _ROW)
        if not np.isfinite(rows).all():
            raise InputError(self._file, "holds values that are not finite", _ROW)
        t, x, y, p = rows.T
        return Events(pixel_coordinates(x), pixel_coordinates(y), to_ns(self._file, t), p > 0)


def _text(path: Path, line: bytes) -> str:
    try:
        return line.decode("ascii")
    except UnicodeDecodeError:
        raise InputError(path, "not a text file", _ROW) from None


def read_imu_text(path: Path) -> Imu:
    """Read ECD's `t ax ay az gx gy gz` in s, m/s^2 and rad/s.

    Raises:
        InputError: lines of another length, or times that do not increase.
    """
    stamps, rows = _read_stamped(path, 7, "t ax ay az gx gy gz")
    return Imu(path.name, stamps, rows[:, 3:], rows[:, :3])


def read_table(path: Path, columns: int, layout: str) -> NDArray[np.float64]:
    """Read lines of so many numbers, (N, columns) with N > 0; `#` begins a comment.

    Args:
        path: the file.
        columns: numbers in a line.
        layout: their names, for errors.

    Raises:
        InputError: not such a file.
    """
    fix = f"give lines '{layout}'"
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(path, f"not a table of numbers ({error})", fix) from None
    if rows.size == 0 or rows.shape[1] != columns:
        raise InputError(path, f"lines of {rows.shape[1]} numbers", fix)
    return rows


def _read_stamped(
    path: Path, columns: int, layout: str
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read a table whose first column is the time in s: times (N,) in ns, and the other columns.

    Raises:
        InputError: see `read_table`, or times that do not increase.
    """
    rows = read_table(path, columns, layout)
    stamps = np.rint(rows[:, 0] * NS_PER_S).astype(np.int64)
    require_increasing(path, stamps)
    return stamps, rows[:, 1:]


def require_increasing(path: Path, stamps: NDArray[np.int64]) -> None:
    """Check that times (N,) in ns increase.

    Raises:
        InputError: they do not.
    """
    if (np.diff(stamps) <= 0).any():
        raise InputError(path, "times are not increasing", "sort the lines by time")
