"""Reader of DSEC's HDF5 event files (Gehrig et al., RA-L 2021).

`events/x`, `y`, `t` and `p` are columns, `t` in microseconds from `t_offset`.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.file_recording import FileRecording
from emoflow_ros.offline.readers.hdf5 import CHUNK, holds, open_hdf5, refuse

_COLUMNS = ("x", "y", "t", "p")
_SIZE = (640, 480)
_US_PER_S = 1_000_000


class DsecRecording(FileRecording):
    """A DSEC `events.h5`."""

    FORMAT = "a DSEC event file (HDF5)"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration)
        self.size = _SIZE
        file = self.stack.enter_context(open_hdf5(path))
        self._columns = [file[f"events/{name}"] for name in _COLUMNS]
        lengths = {len(column) for column in self._columns}
        if len(lengths) != 1:
            self.stack.close()
            raise InputError(path, "event columns of different lengths", "copy it again")
        (self._count,) = lengths
        self._offset = int(file["t_offset"][()]) if "t_offset" in file else 0
        if self._count:
            t = self._columns[_COLUMNS.index("t")]
            self.duration = (int(t[-1]) - int(t[0])) / _US_PER_S

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return holds(path, [f"events/{name}" for name in _COLUMNS])

    def event_chunks(self) -> Iterator[Events]:
        """Stream the events, a million at a time."""
        return self.checked(self._read())

    def _read(self) -> Iterator[Events]:
        for first in range(0, self._count, CHUNK):
            try:
                x, y, t, p = (column[first : first + CHUNK] for column in self._columns)
            except OSError as error:
                refuse(self.path, error)
            t_ns = (t.astype(np.int64) + self._offset) * 1000
            yield Events(x.astype(np.uint16), y.astype(np.uint16), t_ns, p > 0)
