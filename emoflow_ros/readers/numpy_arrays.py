"""Reader of NumPy files: archives (.npz) of the arrays x, y, t and p, and one array (.npy).

In an archive `t_s`, `t_us` and `t_ns` name their unit, and `width` and `height` may give the
sensor's size. One array is a table (N, 4), or has the fields x, y, t and p.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.column_layout import (
    COLUMN_NAMES,
    USUAL_LAYOUT,
    ColumnOptions,
    in_order,
    layout_of_names,
    tell_layout,
)
from emoflow_ros.readers.event_columns import pixel_coordinates, times_ns
from emoflow_ros.readers.numpy_damage import damage_as_value_error
from emoflow_ros.readers.reader_base import FileRecording
from emoflow_ros.readers.time_units import Clues, sampled, tell_unit, unit_name

_ARCHIVE, _ARRAY = ".npz", ".npy"
_UNITS = {"t_s": "s", "t_us": "us", "t_ns": "ns"}
_SIZES = ("width", "height")
_TABLES = ("events", "arr_0")  # of an archive: a name, and what np.savez calls one without
_LAYOUT = "save x, y, t (or t_s, t_us, t_ns) and p of equal length"
_TABLE = "save an array (N, 4), or one with the fields x, y, t and p"
_SAMPLE = 1000

type Arrays = dict[str, NDArray[Any]]


class NumpyRecording(FileRecording):
    """An `.npz` or `.npy` file.

    Attributes:
        encoding: the unit of t, and the order of columns without names.
    """

    FORMAT = "a NumPy file (.npz with x, y, t, p, or .npy)"
    TYPE = "npz"

    def __init__(
        self,
        path: Path,
        *,
        topic: str | None = None,
        calibration: Path | None = None,
        columns: ColumnOptions | None = None,
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration, columns=columns)
        if path.suffix == _ARRAY:
            self.TYPE = "npy"
        arrays = _load(path)
        table = next((arrays.pop(name) for name in _TABLES if name in arrays), None)
        layout = ""
        if table is not None and not _named(arrays):
            named, layout = _from_table(path, table, self.options.layout)
            arrays |= named
        elif self.options.layout:
            raise InputError("--layout", f"{path}: its columns have names", "leave it out")
        t_name = next((name for name in ("t", *_UNITS) if name in arrays), "t")
        x, y, t, p = _columns(path, arrays, t_name)
        self.size = _size(path, arrays)
        self.encoding = ""
        if len(t):
            times = self._times(t, _UNITS.get(t_name, ""), layout)
            self._events = Events(pixel_coordinates(x), pixel_coordinates(y), times, p > 0)
            self.duration = (int(times[-1]) - int(times[0])) / NS_PER_S
        else:
            self._events = Events.empty()

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return path.suffix in (_ARCHIVE, _ARRAY) and path.is_file()

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Yield all events at once: the arrays are in memory."""
        return self.checked([self._events], since)

    def _times(self, t: NDArray[Any], declared: str, layout: str) -> NDArray[np.int64]:
        """Return times in ns."""
        said = layout not in ("", USUAL_LAYOUT, self.options.layout)
        clues = Clues(
            self.path,
            sampled(t.__getitem__, len(t)),
            len(t),
            self.options.time_unit or declared,
            told=" ".join(layout) if said else "",
        )
        unit = tell_unit(clues)
        order = f"{' '.join(layout)}, " if layout else ""
        self.encoding = f"{order}t in {unit_name(unit)}"
        return times_ns(self.path, t, unit)


def _load(path: Path) -> Arrays:
    """Read the arrays that have a meaning, as far as they are there.

    NumPy's messages about damage are not repeated, since they advise to load it unsafely.
    """
    is_archive = path.suffix == _ARCHIVE
    if is_archive and not is_zipfile(path):
        raise InputError(path, "not a NumPy archive, or cut off", "copy it again")
    arrays: Arrays = {}
    name = ""
    try:
        if not is_archive:
            # np.load would take anything else for a pickle
            with damage_as_value_error(), path.open("rb") as file:
                return {_TABLES[0]: np.lib.format.read_array(file, allow_pickle=False)}
        with damage_as_value_error(), np.load(path, allow_pickle=False) as archive:
            for name, letter in _members(archive.files):
                value = archive[name]
                if isinstance(value, np.ndarray):  # other members come as bytes
                    arrays[letter] = value
            if not arrays:
                there = ", ".join(archive.files) or "nothing"
                raise InputError(path, f"no arrays x, y, t and p; it holds {there}", _LAYOUT)
    except (OSError, KeyError, ValueError) as error:
        if "Object arrays" in str(error):
            raise InputError(path, f"{name or 'it'} holds Python objects", "save numbers") from None
        kind = "archive" if is_archive else "array"
        part = f" ({name} cannot be read)" if name and is_archive else ""
        raise InputError(path, f"damaged NumPy {kind}{part}", "copy it again") from None
    return arrays


def _members(files: list[str]) -> Iterator[tuple[str, str]]:
    """Yield the members that have a meaning, each with the name that it is known by here."""
    for letter, names in COLUMN_NAMES.items():
        yield from [(name, letter) for name in names if name in files][:1]
    yield from ((name, name) for name in (*_UNITS, *_SIZES, *_TABLES) if name in files)


def _named(arrays: Arrays) -> bool:
    return any(name in arrays for name in ("x", "y", "t", "p", *_UNITS))


def _from_table(path: Path, table: NDArray[Any], given: str) -> tuple[Arrays, str]:
    """Return the columns of one array by name, and their layout where they have no names.

    Raises:
        InputError: an array of another shape or type, or see `tell_layout`.
    """
    if table.dtype.names:
        layout = layout_of_names(list(table.dtype.names))
        if not layout or given:
            wrong = f"an array with the fields {', '.join(table.dtype.names)}"
            raise InputError(path, wrong, "leave --layout out" if given else _TABLE)
        names = dict(zip(layout, table.dtype.names, strict=True))
        return {letter: np.ravel(table[names[letter]]) for letter in "xytp"}, ""
    if table.ndim == 2 and table.shape[0] == 4 != table.shape[1]:
        table = table.T
    if table.ndim != 2 or table.dtype.kind not in "iuf" or (not given and table.shape[1] != 4):
        wrong = f"an array of shape {table.shape} and type {table.dtype}"
        raise InputError(path, wrong, _TABLE)
    if len(table) == 0:
        return dict(zip("xytp", table.T, strict=False)), ""
    rows = np.concatenate([table[:_SAMPLE], table[-1:]]).astype(np.float64)
    layout = tell_layout(path, rows, given)
    columns = dict(zip("xytp", table.T[in_order(layout)], strict=True))
    return columns, layout


def _columns(path: Path, arrays: Arrays, t_name: str) -> list[NDArray[Any]]:
    """Return x, y, t and p, (N,) each; (N, 1) is taken as that."""
    names = ("x", "y", t_name, "p")
    missing = [name for name in names if name not in arrays]
    if missing:
        there = ", ".join(sorted(arrays)) or "nothing"
        raise InputError(path, f"no array {', '.join(missing)}; it holds {there}", _LAYOUT)
    columns = [arrays[n].ravel() if arrays[n].shape[1:] == (1,) else arrays[n] for n in names]
    if columns[0].ndim != 1 or len({column.shape for column in columns}) != 1:
        shapes = ", ".join(f"{n} {arrays[n].shape}" for n in names)
        raise InputError(path, f"arrays of different shapes ({shapes})", _LAYOUT)
    if any(c.dtype.kind not in "biuf" or not np.isfinite(c).all() for c in columns):
        raise InputError(path, "values that are not finite numbers", _LAYOUT)
    return columns


def _size(path: Path, arrays: Arrays) -> tuple[int, int]:
    values = [arrays.get(name, np.zeros(())) for name in _SIZES]
    if any(v.size != 1 or v.dtype.kind not in "iuf" or not np.isfinite(v).all() for v in values):
        raise InputError(path, "width and height are not one number each", "save the sensor's size")
    width, height = (int(v.item()) for v in values)
    return width, height
