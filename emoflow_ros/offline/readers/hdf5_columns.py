"""Reader of HDF5 files with columns x, y, t and p in any group, as many data sets write them.

EDS has them at the root, TUM-VIE and VECtor in `events`, M3ED in `prophesee/left` and `right`.
A `t_offset` beside them, in the unit of t, is added to t. How the unit is found: hdf5_time.py.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.base import pixel_coordinates
from emoflow_ros.offline.readers.file_recording import FileRecording
from emoflow_ros.offline.readers.hdf5 import CHUNK, is_hdf5, open_hdf5, refuse, row_before
from emoflow_ros.offline.readers.hdf5_time import Clues, unit_ns

# The names that data sets give each column.
_NAMES = (("x", "xs"), ("y", "ys"), ("t", "ts"), ("p", "ps", "pol", "polarity"))
_INDICES = ("ms_to_idx", "ms_map_idx")
_OFFSET = "t_offset"
_SAMPLE = 1000
# Kalibr's names of lens models, which M3ED's calibration has, and ROS's.
_LENSES = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": ""}


class ColumnsRecording(FileRecording):
    """An HDF5 file; its topic is the group of the columns, of several the left camera's."""

    FORMAT = "an HDF5 file with columns x, y, t, p"
    TYPE = "hdf5"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        super().__init__(path, calibration=calibration)
        groups = self.topics(path)
        self.topic = topic or _default(path, groups)
        if self.topic not in groups:
            raise InputError(
                path, f"no event columns in '{topic}'", f"give one of {', '.join(groups)}"
            )
        file = self.stack.enter_context(open_hdf5(path))
        try:
            self._read_head(file, file[self.topic])
        except BaseException:
            self.stack.close()
            raise

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return is_hdf5(path) and bool(ColumnsRecording.topics(path))

    @staticmethod
    def topics(path: Path) -> list[str]:
        """List the groups that hold columns of events."""
        with open_hdf5(path) as file:
            groups = ["/"] if _columns(file) else []

            def visit(name: str, item: Any) -> None:
                if isinstance(item, h5py.Group) and _columns(item):
                    groups.append(name)

            file.visititems(visit)
            return groups

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, a million at a time."""
        return self.checked(self._read(since), since)

    def _read_head(self, file: h5py.File, group: h5py.Group) -> None:
        self._columns = _columns(group)
        lengths = {len(column) for column in self._columns}
        if len(lengths) != 1:
            raise InputError(self.path, "event columns of different lengths", "copy it again")
        (self._count,) = lengths
        self.size = _size(file, group)
        if self.camera is None and all(self.size):
            self.camera = _camera(self.path, group, self.size)
        if self._count == 0:
            return
        t = self._columns[2]
        try:
            offset = _beside(file, group, (_OFFSET,))
            self._offset = 0 if offset is None else np.ravel(offset[()])[0]
            self._unit = unit_ns(_clues(self.path, file, group, t))
            self.duration = int(self._ns(t[-1:])[0] - self._ns(t[:1])[0]) / NS_PER_S
        except OSError as error:
            refuse(self.path, error)

    def _read(self, since: int | None) -> Iterator[Events]:
        t_column = self._columns[2]
        try:
            start = row_before(
                self._count, lambda row: int(self._ns(t_column[row : row + 1])[0]), since
            )
            for first in range(start, self._count, CHUNK):
                x, y, t, p = (column[first : first + CHUNK] for column in self._columns)
                yield Events(pixel_coordinates(x), pixel_coordinates(y), self._ns(t), p > 0)
        except OSError as error:
            refuse(self.path, error)

    def _ns(self, t: NDArray[Any]) -> NDArray[np.int64]:
        if t.dtype.kind == "f" or isinstance(self._offset, np.floating):
            times = (t.astype(np.float64) + float(self._offset)) * self._unit
            if not np.isfinite(times).all():
                raise InputError(self.path, "t holds values that are not finite", "correct it")
            return np.rint(times).astype(np.int64)
        return (t.astype(np.int64) + int(self._offset)) * self._unit


def _default(path: Path, groups: list[str]) -> str:
    """Choose the only group, or the only one of a left camera."""
    left = [name for name in groups if "left" in name.split("/")]
    for found in (groups, left):
        if len(found) == 1:
            return found[0]
    raise InputError(
        path, f"{len(groups)} groups of events: {', '.join(groups)}", "choose with --topic"
    )


def _columns(group: h5py.Group) -> tuple[h5py.Dataset, ...]:
    """Return the columns x, y, t and p of a group; nothing if one is missing."""
    found = []
    for names in _NAMES:
        items = (group.get(name) for name in names)
        column = next((i for i in items if isinstance(i, h5py.Dataset) and i.ndim == 1), None)
        if column is None:
            return ()
        found.append(column)
    return tuple(found)


def _beside(file: h5py.File, group: h5py.Group, names: tuple[str, ...]) -> h5py.Dataset | None:
    """Find a data set in the columns' group or at the root."""
    items = (place.get(name) for place in (group, file) for name in names)
    return next((item for item in items if isinstance(item, h5py.Dataset)), None)


def _clues(path: Path, file: h5py.File, group: h5py.Group, t: h5py.Dataset) -> Clues:
    index = _beside(file, group, _INDICES)
    sample = t[:] if len(t) <= 2 * _SAMPLE else np.concatenate([t[:_SAMPLE], t[-_SAMPLE:]])
    return Clues(path, dict(t.attrs), sample, len(t), 0 if index is None else len(index))


def _size(file: h5py.File, group: h5py.Group) -> tuple[int, int]:
    """Sensor's width and height: of the calibration, or attributes; (0, 0) where unknown."""
    resolution = group.get("calib/resolution")
    if resolution is not None and resolution.shape == (2,):
        width, height = (int(value) for value in resolution[:])
        return width, height
    for place in (group, file):
        if "width" in place.attrs and "height" in place.attrs:
            return int(place.attrs["width"]), int(place.attrs["height"])
    return 0, 0


def _camera(path: Path, group: h5py.Group, size: tuple[int, int]) -> Camera | None:
    """Read M3ED's calibration, where it is there and of a known lens."""
    items = [group.get(f"calib/{name}") for name in ("intrinsics", "distortion_coeffs")]
    lens = group.get("calib/distortion_model")
    if lens is None or None in items or items[0].shape != (4,):
        return None
    word = lens[()]
    model = _LENSES.get(word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word))
    if model is None:
        return None
    (fx, fy, cx, cy), distortion = (np.ravel(item[()]).tolist() for item in items)
    try:
        k = (fx, 0, cx, 0, fy, cy, 0, 0, 1)
        return Camera.from_intrinsic_matrix(*size, k, model, distortion)
    except InputError as error:
        wrong = f"its calibration cannot be used ({error})"
        raise InputError(path, wrong, "give one with --calib FILE") from None
