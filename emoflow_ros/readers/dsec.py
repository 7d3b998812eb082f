"""Reader of DSEC's sequences and event files (Gehrig et al., RA-L 2021).

`events/x`, `y`, `t` and `p` are columns, `t` in microseconds from `t_offset`.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.event_columns import times_ns
from emoflow_ros.readers.hdf5 import CHUNK, damage_refused, holds, open_hdf5, row_before
from emoflow_ros.readers.reader_base import FileRecording
from emoflow_ros.readers.time_units import US, Clues, sampled, tell_unit

_RECTIFY_MAP = "rectify_map.h5"
# As the archives of the whole data set unpack, and as those of one sequence are named.
_EVENTS = ("events/left/events.h5", "*events_left/events.h5", "events.h5")
_CALIBRATION = ("calibration/cam_to_cam.yaml", "*calibration/cam_to_cam.yaml", "cam_to_cam.yaml")
_FLOW = ("flow/forward", "*optical_flow_forward_event", "flow_forward")
_FLOW_TIMES = (
    "flow/forward_timestamps.txt",
    "*optical_flow_forward_timestamps.txt",
    "forward_timestamps.txt",
)
_NAME = re.compile(r"(interlaken|thun|zurich_city)_\d\d_[a-z]")

_COLUMNS = ("x", "y", "t", "p")
_SIZE = (640, 480)
_MAP = "rectify_map"


@dataclass(frozen=True)
class DsecFolder:
    """The folder of a sequence, named after it. A part that is missing raises InputError."""

    path: Path

    @property
    def recognised(self) -> bool:
        """Whether this is a DSEC sequence, by its name or by any of its parts."""
        if not self.path.is_dir():
            return False
        parts = (_EVENTS, _CALIBRATION, _FLOW, _FLOW_TIMES)
        named = _NAME.fullmatch(self.path.resolve().name) is not None
        return named or any(self._find(patterns) for patterns in parts)

    @property
    def events(self) -> Path:
        """The left event camera's `events.h5`."""
        return self._require(_EVENTS, "unpack its events_left.zip there")

    @property
    def rectify_map(self) -> Path:
        """The left event camera's rectify map, beside the events."""
        path = self.events.with_name(_RECTIFY_MAP)
        if not path.is_file():
            raise self._missing(path.relative_to(self.path), "unpack its events_left.zip again")
        return path

    @property
    def calibration(self) -> Path:
        """`cam_to_cam.yaml`."""
        return self._require(_CALIBRATION, "unpack its calibration.zip there")

    @property
    def has_flow(self) -> bool:
        """Whether there is any part of the flow truth; test sequences have none."""
        return self._find(_FLOW) is not None or self._find(_FLOW_TIMES) is not None

    @property
    def flow(self) -> Path:
        """The folder of the forward flow images."""
        return self._require(_FLOW, "unpack its optical_flow_forward_event.zip there")

    @property
    def flow_times(self) -> Path:
        """The intervals of the flow images."""
        return self._require(_FLOW_TIMES, "put its optical_flow_forward_timestamps.txt there")

    @property
    def test_times(self) -> Path | None:
        """The benchmark's intervals of a test sequence, `<sequence>.csv`."""
        return self._find((f"{self.path.resolve().name}.csv",))

    def _find(self, patterns: tuple[str, ...]) -> Path | None:
        return next((p for pattern in patterns for p in sorted(self.path.glob(pattern))), None)

    def _require(self, patterns: tuple[str, ...], fix: str) -> Path:
        found = self._find(patterns)
        if found is None:
            raise self._missing(patterns[0], fix)
        return found

    def _missing(self, part: Path | str, fix: str) -> InputError:
        return InputError(self.path, f"a DSEC sequence without {part}", fix)


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
        self,
        path: Path,
        *,
        topic: str | None = None,
        calibration: Path | None = None,
        columns: ColumnOptions | None = None,
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration, columns=columns)
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
        self.file_name, self.named = events.name, events
        self._unit = US
        file = self.stack.enter_context(open_hdf5(events))
        if not holds(events, [f"events/{name}" for name in _COLUMNS]):
            self.stack.close()
            raise InputError(events, "holds no event columns", "give DSEC's events.h5")
        with damage_refused(events):
            self._columns = [file[f"events/{name}"] for name in _COLUMNS]
        lengths = {len(column) for column in self._columns}
        if len(lengths) != 1:
            self.stack.close()
            raise InputError(events, "event columns of different lengths", "copy it again")
        (self._count,) = lengths
        with damage_refused(events):
            self._offset = int(file["t_offset"][()]) if "t_offset" in file else 0
            if self._count:
                t = self._columns[_COLUMNS.index("t")]
                sample = sampled(t.__getitem__, self._count)
                declared = self.options.time_unit
                self._unit = tell_unit(Clues(events, sample, self._count, declared, of_format=US))
                self.duration = (float(sample[-1]) - float(sample[0])) * self._unit / NS_PER_S

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a sequence's folder, or the file beside a rectify map.

        Other data sets have files of the same columns, and other sensors.
        """
        if DsecFolder(path).recognised:
            return True
        is_dsec = path.is_file() and path.with_name(_RECTIFY_MAP).is_file()
        return is_dsec and holds(path, [f"events/{name}" for name in _COLUMNS])

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, a million at a time."""
        for events in self.checked(self._read(since), since):
            yield events if self._map is None else _rectify(events, self._map)

    def _read(self, since: int | None) -> Iterator[Events]:
        t_column = self._columns[_COLUMNS.index("t")]
        with damage_refused(self.path):
            start = row_before(self._count, lambda row: int(self._ns(t_column[row])), since)
            for first in range(start, self._count, CHUNK):
                x, y, t, p = (column[first : first + CHUNK] for column in self._columns)
                yield Events(x.astype(np.uint16), y.astype(np.uint16), self._ns(t), p > 0)

    def _ns(self, t: Any) -> Any:
        return times_ns(self.named, t.astype(np.int64) + self._offset, self._unit)


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
    try:
        return Camera(width, height, fx, fy, cx, cy)
    except InputError as error:
        fix = f"{error.fix}, or give a calibration with --calib FILE"
        raise InputError(path, f"camRect0: {error.wrong}", fix) from None


def _read_map(path: Path) -> NDArray[np.float32]:
    """Where each pixel of the sensor lies in the rectified view, (H, W, 2) px."""
    if not holds(path, [_MAP]):
        raise InputError(path, f"holds no {_MAP}", "unpack the sequence's events again")
    with open_hdf5(path) as file, damage_refused(path):
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
