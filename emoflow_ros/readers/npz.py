"""Reader of NumPy archives with the arrays x, y, t and p of equal length.

`t_s`, `t_us` and `t_ns` name their unit. A plain `t` holds seconds if it is of a floating-point
type; integers are microseconds, unless they reach 1e17 or span more than an hour as such: then
they are nanoseconds. `width` and `height` may give the sensor's size.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile, is_zipfile

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import NS_PER_S, Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.event_columns import pixel_coordinates, to_ns
from emoflow_ros.readers.reader_base import FileRecording

_UNITS_NS = {"t_s": NS_PER_S, "t_us": 1_000, "t_ns": 1}
_EPOCH_NS = 10**17
_HOUR_US = 3_600_000_000
_SIZES = ("width", "height")
# SyntaxError, TokenError, TypeError: from NumPy's parser of an array's header.
_DAMAGED = (
    OSError, EOFError, ValueError, NotImplementedError, BadZipFile, zlib.error,
    SyntaxError, TokenError, TypeError,
)  # fmt: skip
_LAYOUT = "save x, y, t (or t_s, t_us, t_ns) and p of equal length"


class NpzRecording(FileRecording):
    """An `.npz` file."""

    FORMAT = "a NumPy archive (.npz with x, y, t, p)"
    TYPE = "npz"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration)
        arrays = _load(path)
        t_name = next((name for name in ("t", *_UNITS_NS) if name in arrays), "t")
        missing = [name for name in ("x", "y", t_name, "p") if name not in arrays]
        if missing:
            raise InputError(path, f"no array {', '.join(missing)}", _LAYOUT)
        x, y, t, p = (arrays[name] for name in ("x", "y", t_name, "p"))
        if x.ndim != 1 or len({a.shape for a in (x, y, t, p)}) != 1:
            raise InputError(path, "arrays of different shapes", _LAYOUT)
        if any(a.dtype.kind not in "biuf" or not np.isfinite(a).all() for a in (x, y, t, p)):
            raise InputError(path, "values that are not finite numbers", _LAYOUT)
        times = _to_ns(path, t_name, t)
        self._events = Events(pixel_coordinates(x), pixel_coordinates(y), times, p > 0)
        self.size = _size(path, arrays)
        if len(x):
            self.duration = (int(self._events.t[-1]) - int(self._events.t[0])) / NS_PER_S

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return path.suffix == ".npz" and path.is_file()

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Yield all events at once: the archive is in memory."""
        return self.checked([self._events], since)


def _load(path: Path) -> dict[str, NDArray[Any]]:
    """Read the arrays that have a meaning, as far as they are there.

    NumPy's messages about damage are not repeated, since they advise to load it unsafely.
    """
    if not is_zipfile(path):
        raise InputError(path, "not a NumPy archive, or cut off", "copy it again")
    arrays: dict[str, NDArray[Any]] = {}
    name = ""
    try:
        with np.load(path, allow_pickle=False) as archive:
            for name in {"x", "y", "t", "p", *_UNITS_NS, *_SIZES}.intersection(archive.files):
                value = archive[name]
                if isinstance(value, np.ndarray):  # other members come as bytes
                    arrays[name] = value
    except _DAMAGED as error:
        if "Object arrays" in str(error):
            raise InputError(path, f"{name} holds Python objects", "save numbers") from None
        part = f" ({name} cannot be read)" if name else ""
        raise InputError(path, f"damaged NumPy archive{part}", "copy it again") from None
    return arrays


def _size(path: Path, arrays: dict[str, NDArray[Any]]) -> tuple[int, int]:
    values = [arrays.get(name, np.zeros(())) for name in _SIZES]
    if any(v.size != 1 or v.dtype.kind not in "iuf" or not np.isfinite(v).all() for v in values):
        raise InputError(path, "width and height are not one number each", "save the sensor's size")
    width, height = (int(v.item()) for v in values)
    return width, height


def _to_ns(path: Path, name: str, t: NDArray[Any]) -> NDArray[np.int64]:
    unit = _UNITS_NS.get(name) or _guess_unit(t)
    if t.dtype.kind == "f":
        return to_ns(path, t, unit)
    return t.astype(np.int64) * unit


def _guess_unit(t: NDArray[Any]) -> int:
    if t.dtype.kind == "f":
        return NS_PER_S
    if len(t) and (int(t[-1]) >= _EPOCH_NS or int(t[-1]) - int(t[0]) > _HOUR_US):
        return 1
    return 1_000
