"""Reader of HDF5 files with columns x, y, t and p in any group, as many data sets write them.

EDS has them at the root, TUM-VIE and VECtor in `events`, M3ED in `prophesee/left` and `right`.
A `t_offset` beside them, in the unit of t, is added to t. `unit_ns` says how the unit is found.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.event_columns import pixel_coordinates, to_ns
from emoflow_ros.readers.hdf5 import CHUNK, damage_refused, is_hdf5, open_hdf5, row_before
from emoflow_ros.readers.reader_base import FileRecording

# The names that data sets give each column.
_NAMES = (("x", "xs"), ("y", "ys"), ("t", "ts"), ("p", "ps", "pol", "polarity"))
_INDICES = ("ms_to_idx", "ms_map_idx")
_OFFSET = "t_offset"
_SAMPLE = 1000
_LENSES = ("radtan", "equidistant", "none")  # that M3ED's calibration names

_WORDS = {
    "s": NS_PER_S, "sec": NS_PER_S, "second": NS_PER_S, "seconds": NS_PER_S,
    "ms": NS_PER_MS, "millisecond": NS_PER_MS, "milliseconds": NS_PER_MS,
    "us": 1000, "usec": 1000, "µs": 1000, "microsecond": 1000, "microseconds": 1000,
    "ns": 1, "nsec": 1, "nanosecond": 1, "nanoseconds": 1,
}  # fmt: skip
_ATTRIBUTES = ("unit", "units")
_EPOCH_NS, _EPOCH_US = 1e17, 1e14
_HOUR_US = 3_600_000_000
_MIN_RATE, _MAX_RATE = 1e3, 3e7  # events/s, mean of a recording
_NS_BYTES = 8  # of a number that can hold nanoseconds
_UNIT_TOLERANCE = 10.0  # units are a factor of 1000 apart
_UNIT_FIX = "give the column t an attribute 'unit': s, us or ns"


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
        """List the groups that hold columns of events."""
        with open_hdf5(path) as file, damage_refused(path):
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
        offset = _beside(file, group, (_OFFSET,))
        self._offset = 0 if offset is None else np.ravel(offset[()])[0]
        self._unit = unit_ns(_clues(self.path, file, group, t))
        self.duration = int(self._ns(t[-1:])[0] - self._ns(t[:1])[0]) / NS_PER_S

    def _read(self, since: int | None) -> Iterator[Events]:
        t_column = self._columns[2]
        with damage_refused(self.path):
            start = row_before(
                self._count, lambda row: int(self._ns(t_column[row : row + 1])[0]), since
            )
            for first in range(start, self._count, CHUNK):
                x, y, t, p = (column[first : first + CHUNK] for column in self._columns)
                yield Events(pixel_coordinates(x), pixel_coordinates(y), self._ns(t), p > 0)

    def _ns(self, t: NDArray[Any]) -> NDArray[np.int64]:
        if t.dtype.kind == "f" or isinstance(self._offset, np.floating):
            return to_ns(self.path, t.astype(np.float64) + float(self._offset), self._unit)
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


def _clues(path: Path, file: h5py.File, group: h5py.Group, t: h5py.Dataset) -> "Clues":
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
    model = word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word)
    if model not in _LENSES:
        return None
    (fx, fy, cx, cy), distortion = (np.ravel(item[()]).tolist() for item in items)
    try:
        k = (fx, 0, cx, 0, fy, cy, 0, 0, 1)
        return Camera.from_intrinsic_matrix(*size, k, model, distortion)
    except InputError as error:
        wrong = f"its calibration cannot be used ({error.wrong})"
        raise InputError(path, wrong, "give one with --calib FILE") from None


@dataclass(frozen=True)
class Clues:
    """What is known of a column of times.

    Attributes:
        path: the file, for errors.
        attributes: of the column.
        sample: (M,) some of its values, M > 0; the first and the last one are the column's.
        count: how many values it has.
        milliseconds: the length of the index of milliseconds; 0 without one.
    """

    path: Path
    attributes: dict[str, Any]
    sample: NDArray[Any]
    count: int
    milliseconds: int = 0

    @property
    def span(self) -> float:
        """Last minus first value."""
        return float(self.sample[-1]) - float(self.sample[0])


def unit_ns(clues: Clues) -> int:
    """Return the nanoseconds of one unit of the column t, which few data sets declare.

    What decides, in this order:

    1. The attribute `unit` or `units` of the column: s, ms, us or ns, or their names.
    2. An index of milliseconds beside it (`ms_to_idx`, `ms_map_idx`): its length is the
       recording's in milliseconds.
    3. Times of day since 1970: above 1e17 they are nanoseconds, above 1e14 microseconds.
    4. Floating-point values with at least one event per unit of time are seconds.
    5. Of the others, nanoseconds are those that would span more than an hour as microseconds, and
       whole thousands (event cameras count microseconds) of at most 3e7 events per second. 32-bit
       integers are none: they hold 4 s of nanoseconds.
    6. Microseconds are those of at least 1000 events per second.

    All else is refused.

    Raises:
        InputError: an unknown unit, or nothing that decides.
    """
    for decide in (_declared, _from_index, _from_epoch, _from_rate):
        unit = decide(clues)
        if unit is not None:
            return unit
    raise InputError(
        clues.path,
        f"the unit of t cannot be told: {clues.count} events over {clues.span:g} units",
        _UNIT_FIX,
    )


def _declared(clues: Clues) -> int | None:
    for name in _ATTRIBUTES:
        if name in clues.attributes:
            word = clues.attributes[name]
            word = word.decode("utf-8", "replace") if isinstance(word, bytes) else str(word)
            unit = _WORDS.get(word.strip().lower())
            if unit is None:
                raise InputError(clues.path, f"t has the unknown unit '{word}'", _UNIT_FIX)
            return unit
    return None


def _from_index(clues: Clues) -> int | None:
    if clues.milliseconds == 0:
        return None
    # The index counts from t = 0 or from the first event.
    for length in (clues.span, float(clues.sample[-1])):
        for unit in (1, 1000, NS_PER_S):
            ratio = length * unit / (clues.milliseconds * NS_PER_MS)
            if 1 / _UNIT_TOLERANCE < ratio < _UNIT_TOLERANCE:
                return unit
    return None


def _from_epoch(clues: Clues) -> int | None:
    last = float(clues.sample[-1])
    if last >= _EPOCH_NS:
        return 1
    return 1000 if last >= _EPOCH_US else None


def _from_rate(clues: Clues) -> int | None:
    values, span = clues.sample, clues.span
    if values.dtype.kind == "f" and clues.count >= span:
        return NS_PER_S
    if values.dtype.itemsize == _NS_BYTES and (
        span > _HOUR_US or (clues.count * 1e9 <= _MAX_RATE * span and _are_thousands(values))
    ):
        return 1
    return 1000 if clues.count * 1e6 >= _MIN_RATE * span else None


def _are_thousands(values: NDArray[Any]) -> bool:
    """Whether all of enough values, which differ, are whole thousands."""
    return len(np.unique(values)) >= 10 and not (values % 1000).any()
