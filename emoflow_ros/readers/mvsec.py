"""Reader of MVSEC's HDF5 data files (Zhu et al., RA-L 2018).

`davis/left/events` and `davis/right/events` are tables (N, 4) of x, y, t in seconds and p = +-1.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.event_columns import pixel_coordinates, times_ns
from emoflow_ros.readers.hdf5 import CHUNK, damage_refused, holds, open_hdf5, row_before
from emoflow_ros.readers.reader_base import FileRecording
from emoflow_ros.readers.time_units import Clues, S, sampled, tell_unit

_LEFT = "davis/left/events"  # the camera that MVSEC's ground truth belongs to
_TOPICS = (_LEFT, "davis/right/events")
_SIZE = (346, 260)
_X, _Y, _T, _P = range(4)


class MvsecRecording(FileRecording):
    """An MVSEC `*_data.hdf5`; its topic is the table, the left camera's by default."""

    FORMAT = "an MVSEC *_data.hdf5"
    TYPE = "mvsec/hdf5"

    def __init__(
        self,
        path: Path,
        *,
        topic: str | None = None,
        calibration: Path | None = None,
        columns: ColumnOptions | None = None,
    ) -> None:
        super().__init__(path, calibration=calibration, columns=columns)
        self.size = _SIZE
        self.topic = topic or _LEFT
        if self.topic not in _TOPICS or not holds(path, [self.topic]):
            raise InputError(path, f"no event table '{topic}'", f"give one of {', '.join(_TOPICS)}")
        with damage_refused(path):
            self._table = self.stack.enter_context(open_hdf5(path))[self.topic]
        if self._table.ndim != 2 or self._table.shape[1] != 4:
            self.stack.close()
            raise InputError(
                path, f"an event table of shape {self._table.shape}", "a row is 'x y t p'"
            )
        self._unit = S
        with damage_refused(path):
            self.duration = self._measure()

    def _measure(self) -> float | None:
        """Tell the unit of t, which is seconds in MVSEC's files, and return the length in s."""
        count = len(self._table)
        if count == 0:
            return None
        t = sampled(lambda rows: np.asarray(self._table[rows, _T]), count)
        clues = Clues(self.path, t, count, self.options.time_unit, of_format=S)
        self._unit = tell_unit(clues)
        first, last = (int(self._ns(self._table[row, _T])) for row in (0, -1))
        return (last - first) / NS_PER_S

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return holds(path, [_LEFT])

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, a million at a time."""
        return self.checked(self._read(since), since)

    def _read(self, since: int | None) -> Iterator[Events]:
        with damage_refused(self.path):
            count = len(self._table)
            start = row_before(count, lambda row: int(self._ns(self._table[row, _T])), since)
            for first in range(start, count, CHUNK):
                rows = self._table[first : first + CHUNK]
                x, y = pixel_coordinates(rows[:, _X]), pixel_coordinates(rows[:, _Y])
                yield Events(x, y, self._ns(rows[:, _T]), rows[:, _P] > 0)

    def _ns(self, t: Any) -> Any:
        return times_ns(self.path, t, self._unit)
