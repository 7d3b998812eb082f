"""Reader of events in text files: the Event-Camera Dataset's folders, and columns of any order.

The data set: Mueggler et al., IJRR 2017. Its `events.txt` has lines `t x y p`, t in seconds.
Simulators write other orders and units, which the first 1000 lines tell.
"""

from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.column_layout import USUAL_LAYOUT, ColumnOptions, in_order, tell_layout
from emoflow_ros.readers.event_columns import pixel_coordinates, times_ns
from emoflow_ros.readers.reader_base import FileRecording, Imu, read_camera, refuse_imu_topic
from emoflow_ros.readers.search_in_time import first_since
from emoflow_ros.readers.text_head import ROW, TextHead, decoded, is_row, plain, read_head
from emoflow_ros.readers.text_tables import IMU_FILE, read_imu_text
from emoflow_ros.readers.time_units import Clues, S, tell_unit, unit_name

_EVENTS = "events.txt"
_SUFFIXES = (".txt", ".csv", ".tsv")
_CHUNK_BYTES = 4 << 20  # about 200 000 events
_COLUMNS = "xytp"


class EcdRecording(FileRecording):
    """A folder with `events.txt` and, maybe, `calib.txt`; its `events.txt`, or another text file.

    Attributes:
        encoding: the order of the columns, and the unit of t.
    """

    FORMAT = "an ECD folder or its events.txt (beside it calib.txt), or another text file of events"
    TYPE = "ecd/events.txt"

    def __init__(
        self,
        path: Path,
        *,
        topic: str | None = None,
        calibration: Path | None = None,
        columns: ColumnOptions | None = None,
    ) -> None:
        if topic is not None:
            raise InputError(path, "a text file of events has no topics", "leave --topic out")
        super().__init__(path, columns=columns)
        self.named = path / _EVENTS if path.is_dir() else path
        self.file_name = self.named.name
        if self.file_name == _EVENTS:
            self.path = self.named.parent
        else:
            self.TYPE = "text"
        own = self.named.with_name("calib.txt")
        file = calibration or (own if own.exists() else None)
        self.camera = read_camera(file) if file else None
        self._head = read_head(self.named)
        self._columns = len(self._head.rows[0])
        self._order, self._unit = self._tell(self._head)
        self.duration = self._measure(self._head)
        self.size = self._head.size

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a folder of this format, the file in it, or another text file."""
        return (path / _EVENTS).is_file() or (path.suffix in _SUFFIXES and path.is_file())

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, some 200 000 at a time."""
        start = self._head.begin if since is None else self._byte_before(since)
        return self.checked(self._read(start), since)

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read `imu.txt` in the folder, where it is there; see Recording."""
        refuse_imu_topic(self.path, topic)
        file = self.named.with_name(IMU_FILE)
        return read_imu_text(file) if file.is_file() else None

    def _tell(self, head: TextHead) -> tuple[list[int], int]:
        """Return the columns of x, y, t and p, and the nanoseconds of the unit of t."""
        given = self.options.layout or head.names
        layout = tell_layout(self.named, head.rows, given)
        order = in_order(layout)
        t_column = order[_COLUMNS.index("t")]
        told = "" if given or layout == USUAL_LAYOUT else " ".join(layout)
        declared = self.options.time_unit
        unit = tell_unit(
            Clues(
                self.named,
                head.rows[:, t_column],
                head.count,
                declared,
                told=told,
                has_point=bool(head.points[t_column]),
                of_format=S,
            )
        )
        self.encoding = f"{' '.join(layout)}, t in {unit_name(unit)}"
        return order, unit

    def _read(self, start: int) -> Iterator[Events]:
        """Read from the line on that begins at a byte."""
        with self.named.open("rb") as lines:
            lines.seek(start)
            while text := lines.read(_CHUNK_BYTES):
                yield self._parse(text + lines.readline())

    def _byte_before(self, since: int) -> int:
        """Find the start of a line before the first one at or after a time, by bisection."""
        begin = self._head.begin
        with self.named.open("rb") as file:

            def line_after(byte: int) -> int:
                file.seek(byte)
                file.readline()
                return file.tell()

            def time_after(byte: int) -> int:
                file.seek(line_after(byte))
                row = _next_row(file)
                return int(self._parse(row).t[0]) if row else since

            at = first_since(begin, self.named.stat().st_size, time_after, since)
            return line_after(at - 1) if at > begin else begin

    def _measure(self, head: TextHead) -> float:
        """Length in seconds from the first and the last row."""
        t = self._ns(head.rows[[0, -1]])
        return float(t[1] - t[0]) / NS_PER_S

    def _parse(self, text: bytes) -> Events:
        try:
            rows = np.loadtxt(StringIO(decoded(self.named, plain(text))), np.float64, ndmin=2)
        except ValueError as error:
            raise InputError(self.named, f"not a table of numbers ({error})", ROW) from None
        if rows.size == 0:
            return Events.empty()
        if rows.shape[1] != self._columns:
            wrong = f"lines of {self._columns} numbers and lines of {rows.shape[1]} numbers"
            raise InputError(self.named, wrong, ROW)
        if not np.isfinite(rows).all():
            raise InputError(self.named, "holds values that are not finite", ROW)
        x, y, _, p = rows[:, self._order].T
        return Events(pixel_coordinates(x), pixel_coordinates(y), self._ns(rows), p > 0)

    def _ns(self, rows: NDArray[np.float64]) -> NDArray[np.int64]:
        return times_ns(self.named, rows[:, self._order[_COLUMNS.index("t")]], self._unit)


def _next_row(file: BinaryIO) -> bytes:
    """Return the next line that is a row; nothing behind the last one."""
    return next((line for line in iter(file.readline, b"") if is_row(line)), b"")
