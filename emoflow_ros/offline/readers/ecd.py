"""Reader of the Event-Camera Dataset's folders (Mueggler et al., IJRR 2017)."""

from collections.abc import Iterator
from io import StringIO
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.calibration import load_calibration
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.base import StreamCheck

_EVENTS = "events.txt"
_CHUNK_BYTES = 4 << 20  # about 200 000 events
_OUTSIDE = np.iinfo(np.uint16).max
_ROW = "a line is 't x y p': seconds, pixel column, pixel row, 0 or 1"


class EcdRecording:
    """A folder with `events.txt` (`t[s] x y p`) and `calib.txt`."""

    FORMAT = "an ECD folder (events.txt, calib.txt)"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        if topic is not None:
            raise InputError(path, "an ECD folder has no topics", "leave --topic out")
        self.path = path
        self.topic = ""
        own = path / "calib.txt"
        file = calibration or (own if own.exists() else None)
        self.camera = load_calibration(file) if file else None
        self._file = path / _EVENTS
        self.duration: float | None = self._measure()

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a folder of this format."""
        return (path / _EVENTS).is_file()

    def event_chunks(self) -> Iterator[Events]:
        """Stream the events, some 200 000 at a time."""
        camera = self.camera
        size = (camera.width, camera.height) if camera else (_OUTSIDE, _OUTSIDE)
        check = StreamCheck(self._file, *size)
        with self._file.open(encoding="ascii") as lines:
            while text := lines.read(_CHUNK_BYTES):
                yield check(self._parse(text + lines.readline()))
        check.finish()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Nothing is held open between calls."""

    def _measure(self) -> float:
        """Length in seconds from the first and the last line."""
        with self._file.open("rb") as file:
            first = file.readline()
            file.seek(max(0, self._file.stat().st_size - 4096))
            tail = file.read().splitlines()
        if not first.strip():
            raise InputError(self._file, "holds no events", "give a recording that has some")
        start, end = (self._parse(_text(self._file, line)).t for line in (first, tail[-1]))
        return float(end[0] - start[0]) / NS_PER_S

    def _parse(self, text: str) -> Events:
        try:
            rows = np.loadtxt(StringIO(text), dtype=np.float64, ndmin=2)
        except ValueError as error:
            raise InputError(self._file, f"not a table of numbers ({error})", _ROW) from None
        if rows.shape[1] != 4:
            raise InputError(self._file, f"lines of {rows.shape[1]} numbers", _ROW)
        if not np.isfinite(rows).all():
            raise InputError(self._file, "holds values that are not finite", _ROW)
        t, x, y, p = rows.T
        return Events(_coordinate(x), _coordinate(y), np.rint(t * NS_PER_S).astype(np.int64), p > 0)


def _coordinate(values: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Convert to the type of `Events`; what does not fit becomes its largest value: outside."""
    fits = (values >= 0) & (values < _OUTSIDE)
    return np.where(fits, values, _OUTSIDE).astype(np.uint16)


def _text(path: Path, line: bytes) -> str:
    try:
        return line.decode("ascii")
    except UnicodeDecodeError:
        raise InputError(path, "not a text file", _ROW) from None
