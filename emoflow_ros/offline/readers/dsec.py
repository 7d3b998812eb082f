"""Reader of DSEC's sequences and event files (Gehrig et al., RA-L 2021).

`events/x`, `y`, `t` and `p` are columns, `t` in microseconds from `t_offset`.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.dsec_folder import RECTIFY_MAP, DsecFolder
from emoflow_ros.offline.readers.file_recording import FileRecording
from emoflow_ros.offline.readers.hdf5 import CHUNK, holds, open_hdf5, refuse, row_before

_COLUMNS = ("x", "y", "t", "p")
_SIZE = (640, 480)
_US_PER_S = 1_000_000
_MAP = "rectify_map"


class DsecRecording(FileRecording):
    """A DSEC sequence's folder, or its `events.h5` alone.

    A folder gives the events in the rectified view of the left event camera, which the data
    set's truth lies in, each on the pixel nearest to where the rectify map has it, and the
    calibration of that view. The events of a single file, or of a folder with a calibration of
    the user's own, stay on the sensor's pixels.

    Attributes:
        rectified: whether events and camera are those of the rectified view.
    """

    FORMAT = "the folder of a DSEC sequence or its events.h5"
    TYPE = "dsec/events.h5"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration)
        self.size = _SIZE
        self.rectified = path.is_dir() and calibration is None
        self._map: NDArray[np.float32] | None = None
        events = path
        if path.is_dir():
            folder = DsecFolder(path)
            events = folder.events
            if self.rectified:
                self.camera = rectified_camera(folder.calibration)
                self._map = _read_map(folder.rectify_map)
        self.file_name = events.name
        file = self.stack.enter_context(open_hdf5(events))
        if not holds(events, [f"events/{name}" for name in _COLUMNS]):
            self.stack.close()
            raise InputError(events, "holds no event columns", "give DSEC's events.h5")
        self._columns = [file[f"events/{name}"] for name in _COLUMNS]
        lengths = {len(column) for column in self._columns}
        if len(lengths) != 1:
            self.stack.close()
            raise InputError(events, "event columns of different lengths", "copy it again")
        (self._count,) = lengths
        self._offset = int(file["t_offset"][()]) if "t_offset" in file else 0
        if self._count:
            t = self._columns[_COLUMNS.index("t")]
            self.duration = (int(t[-1]) - int(t[0])) / _US_PER_S

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a sequence's folder, or the file beside a rectify map.

        Other data sets have files of the same columns, and other sensors.
        """
        if DsecFolder(path).recognised:
            return True
        is_dsec = path.with_name(RECTIFY_MAP).is_file()
        return is_dsec and holds(path, [f"events/{name}" for name in _COLUMNS])

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, a million at a time."""
        for events in self.checked(self._read(since), since):
            yield events if self._map is None else _rectify(events, self._map)

    def _read(self, since: int | None) -> Iterator[Events]:
        t_column = self._columns[_COLUMNS.index("t")]
        try:
            start = row_before(self._count, lambda row: int(self._ns(t_column[row])), since)
            for first in range(start, self._count, CHUNK):
                x, y, t, p = (column[first : first + CHUNK] for column in self._columns)
                yield Events(x.astype(np.uint16), y.astype(np.uint16), self._ns(t), p > 0)
        except OSError as error:
            refuse(self.path, error)

    def _ns(self, t: Any) -> Any:
        return (t.astype(np.int64) + self._offset) * 1000


def rectified_camera(path: Path) -> Camera:
    """Read the rectified left event camera from `cam_to_cam.yaml`: a pinhole without a lens.

    Raises:
        InputError: not such a file.
    """
    try:
        tree = yaml.safe_load(path.read_text(encoding="utf-8"))
        view = tree["intrinsics"]["camRect0"]
        fx, fy, cx, cy = (float(value) for value in view["camera_matrix"])
        width, height = (int(value) for value in view.get("resolution", _SIZE))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError):
        raise InputError(
            path, "holds no intrinsics of camRect0", "unpack the sequence's calibration again"
        ) from None
    return Camera(width, height, fx, fy, cx, cy)


def _read_map(path: Path) -> NDArray[np.float32]:
    """Where each pixel of the sensor lies in the rectified view, (H, W, 2) px."""
    if not holds(path, [_MAP]):
        raise InputError(path, f"holds no {_MAP}", "unpack the sequence's events again")
    with open_hdf5(path) as file:
        table = file[_MAP][:].astype(np.float32)
    if table.shape != (_SIZE[1], _SIZE[0], 2):
        raise InputError(path, f"a map of shape {table.shape}", "give the map of a 640x480 sensor")
    return table


def _rectify(events: Events, table: NDArray[np.float32]) -> Events:
    """Move events to the nearest pixels of the rectified view; leave out those beside it."""
    x, y = np.rint(table[events.y, events.x]).T
    inside = (x >= 0) & (x < _SIZE[0]) & (y >= 0) & (y < _SIZE[1])
    return Events(
        x[inside].astype(np.uint16), y[inside].astype(np.uint16), events.t[inside], events.p[inside]
    )
