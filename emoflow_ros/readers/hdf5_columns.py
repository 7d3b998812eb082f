"""Reader of HDF5 files with columns x, y, t and p in any group, as many data sets write them.

EDS has them at the root, TUM-VIE and VECtor in `events`, M3ED in `prophesee/left` and `right`.
They may also be the fields of one data set (Metavision's `CD/events`), or the columns of a table
(N, 4) without names (v2e's `events`). A `t_offset` beside them, in the unit of t, is added to t.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.column_layout import USUAL_LAYOUT, ColumnOptions
from emoflow_ros.readers.event_columns import pixel_coordinates, times_ns
from emoflow_ros.readers.hdf5 import CHUNK, damage_refused, is_hdf5, items_of, open_hdf5, row_before
from emoflow_ros.readers.hdf5_tables import Column, columns_of, tables_of
from emoflow_ros.readers.reader_base import FileRecording
from emoflow_ros.readers.time_units import Clues, sampled, tell_unit, unit_name

_INDICES = ("ms_to_idx", "ms_map_idx")
_OFFSET = "t_offset"
_ATTRIBUTES = ("unit", "units")
_LENSES = ("radtan", "equidistant", "none")  # that M3ED's calibration names


class ColumnsRecording(FileRecording):
    """An HDF5 file; its topic is the group of the columns, of several the left camera's.

    Attributes:
        encoding: the unit of t, and the order of columns without names.
    """

    FORMAT = "an HDF5 file with columns x, y, t, p"
    TYPE = "hdf5"

    def __init__(
        self,
        path: Path,
        *,
        topic: str | None = None,
        calibration: Path | None = None,
        columns: ColumnOptions | None = None,
    ) -> None:
        super().__init__(path, calibration=calibration, columns=columns)
        groups = self.topics(path)
        self.topic = topic or _default(path, groups)
        if self.topic not in groups:
            raise InputError(
                path, f"no event columns in '{topic}'", f"give one of {', '.join(groups)}"
            )
        file = self.stack.enter_context(open_hdf5(path))
        try:
            with damage_refused(path):
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
        """List the groups and data sets that hold columns of events.

        Tables without names count only where there is nothing else.
        """
        with open_hdf5(path) as file, damage_refused(path):
            groups = ["/"] if columns_of(file) else []
            groups += [name for name, item in items_of(file) if columns_of(item)]
            return groups or tables_of(file)

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, a million at a time."""
        return self.checked(self._read(since), since)

    def _read_head(self, file: h5py.File, item: h5py.Group | h5py.Dataset) -> None:
        group = item if isinstance(item, h5py.Group) else item.parent
        self._columns, layout = columns_of(item), ""
        if self._columns and self.options.layout:
            raise InputError("--layout", f"{self.path}: its columns have names", "leave it out")
        if not self._columns:
            self._columns, layout = Column.of_table(self.path, item, self.options.layout)
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
        offset = _beside(file, group, (_OFFSET,))
        self._offset = 0 if offset is None else np.ravel(offset[()])[0]
        self._unit = tell_unit(self._clues(file, group, t, layout))
        order = f"{' '.join(layout)}, " if layout else ""
        self.encoding = f"{order}t in {unit_name(self._unit)}"
        self.duration = int(self._ns(t[-1:])[0] - self._ns(t[:1])[0]) / NS_PER_S

    def _clues(self, file: h5py.File, group: h5py.Group, t: Column, layout: str) -> Clues:
        index = _beside(file, group, _INDICES)
        words = [t.attributes[name] for name in _ATTRIBUTES if name in t.attributes]
        said = layout not in ("", USUAL_LAYOUT, self.options.layout)
        return Clues(
            self.path,
            sampled(t.__getitem__, len(t)),
            len(t),
            self.options.time_unit or next(map(_word, words), ""),
            0 if index is None else len(index),
            " ".join(layout) if said else "",
        )

    def _read(self, since: int | None) -> Iterator[Events]:
        t_column = self._columns[2]
        with damage_refused(self.path):
            start = row_before(
                self._count, lambda row: int(self._ns(t_column[row : row + 1])[0]), since
            )
            for first in range(start, self._count, CHUNK):
                x, y, t, p = (column[first : first + CHUNK] for column in self._columns)
                yield Events(pixel_coordinates(x), pixel_coordinates(y), self._ns(t), p > 0)

    def _with_offset(self, t: NDArray[Any]) -> NDArray[Any]:
        """Add the offset, in a type that holds the sum; without one the column as it is."""
        if not self._offset:
            return t
        if t.dtype.kind == "f" or isinstance(self._offset, np.floating):
            return t.astype(np.float64) + float(self._offset)
        return t.astype(np.int64) + int(self._offset)

    def _ns(self, t: NDArray[Any]) -> NDArray[np.int64]:
        return times_ns(self.path, self._with_offset(t), self._unit)


def _word(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def _default(path: Path, groups: list[str]) -> str:
    """Choose the only group, or the only one of a left camera."""
    left = [name for name in groups if "left" in name.split("/")]
    for found in (groups, left):
        if len(found) == 1:
            return found[0]
    raise InputError(
        path, f"{len(groups)} groups of events: {', '.join(groups)}", "choose with --topic"
    )


def _beside(file: h5py.File, group: h5py.Group, names: tuple[str, ...]) -> h5py.Dataset | None:
    """Find a data set in the columns' group or at the root."""
    items = (place.get(name) for place in (group, file) for name in names)
    return next((item for item in items if isinstance(item, h5py.Dataset)), None)


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
    model = _word(lens[()])
    if model not in _LENSES:
        return None
    (fx, fy, cx, cy), distortion = (np.ravel(item[()]).tolist() for item in items)
    try:
        k = (fx, 0, cx, 0, fy, cy, 0, 0, 1)
        return Camera.from_intrinsic_matrix(*size, k, model, distortion)
    except InputError as error:
        wrong = f"its calibration cannot be used ({error.wrong})"
        raise InputError(path, wrong, "give one with --calib FILE") from None
