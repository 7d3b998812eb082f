"""The beginning of a text file of events: comments, names of columns, the sensor's size, rows."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.errors import InputError
from emoflow_ros.readers.column_layout import layout_of_names
from emoflow_ros.readers.time_units import END_VALUES

ROW = "a line is 't x y p': time, pixel column, pixel row, 0 or 1"
_ROWS = 1000
_TAIL_BYTES = 4096
_BOM = b"\xef\xbb\xbf"
_COMMENTS = (b"#", b"%", b"//")
_SEPARATORS = bytes.maketrans(b",;", b"  ")


@dataclass(frozen=True)
class TextHead:
    """What the first lines of a file of events say.

    Attributes:
        begin: the byte that the first row begins at.
        rows: (M, columns) the first 1000 rows, M > 0, and the last nine behind them.
        count: of all rows; estimated by the length of these where there are more.
        points: (columns,) whether the first one has a decimal point.
        names: the layout by a line of names; empty without one.
        size: (width, height) where the first line holds only these; else (0, 0).
    """

    begin: int
    rows: NDArray[np.float64]
    count: int
    points: NDArray[np.bool_]
    names: str
    size: tuple[int, int]


def is_row(line: bytes) -> bool:
    """Whether a line is neither blank nor a comment."""
    text = line.removeprefix(_BOM).strip()
    return bool(text) and not text.startswith(_COMMENTS)


def plain(text: bytes) -> bytes:
    """Replace commas and semicolons by blanks, and leave out comments."""
    text = text.removeprefix(_BOM)
    if b"," in text or b";" in text:
        text = text.translate(_SEPARATORS)
    if any(mark in text for mark in _COMMENTS):
        lines = (line.partition(b"#")[0] for line in text.splitlines() if is_row(line))
        text = b"\n".join(lines)
    return text


def read_head(path: Path) -> TextHead:
    """Read a file's first and last lines.

    Raises:
        InputError: no events, or lines that are not rows of as many numbers.
    """
    with path.open("rb") as file:
        names, size = "", (0, 0)
        rows: list[list[float]] = []
        points: list[bool] = []
        begin = end = 0
        for at, line in _rows(file):
            words = decoded(path, plain(line)).split()
            if not rows and not names and size == (0, 0):
                unnamed = line.lstrip().startswith((b",", b";"))  # the index that pandas writes
                names = layout_of_names(["-"] * unnamed + words)
                size = _size(words)
                if names or any(size):
                    continue
            if not rows:
                begin, points = at, ["." in word for word in words]
            rows.append(numbers(path, words))
            end = at + len(line)
            if len(rows) == _ROWS:
                break
        if not rows:
            raise InputError(path, "holds no events", "give a recording that has some")
        count = len(rows)
        length = file.seek(0, 2)
        last = _tail(file, end, length)
    rows += [numbers(path, decoded(path, plain(line)).split()) for line in last]
    lengths = {len(row): None for row in rows}
    if len(lengths) > 1:
        found = " and ".join(f"lines of {length} numbers" for length in lengths)
        raise InputError(path, f"not a table of numbers ({found})", ROW)
    if count == _ROWS:
        count = round(count * (length - begin) / (end - begin))
    return TextHead(begin, np.array(rows), count, np.array(points), names, size)


def decoded(path: Path, text: bytes) -> str:
    """Decode a text.

    Raises:
        InputError: it is none.
    """
    try:
        return text.decode("ascii")
    except UnicodeDecodeError:
        raise InputError(path, "not a text file", ROW) from None


def numbers(path: Path, words: list[str]) -> list[float]:
    """Parse the words of a line.

    Raises:
        InputError: one is no number.
    """
    try:
        return [float(word) for word in words]
    except ValueError as error:
        raise InputError(path, f"not a table of numbers ({error})", ROW) from None


def _tail(file: BinaryIO, begin: int, end: int) -> list[bytes]:
    """Return the last rows of a file's bytes, as many as tell the end of its time."""
    start = max(begin, end - _TAIL_BYTES)
    file.seek(start)
    lines = file.read().splitlines()[start > begin :]  # the first one may be cut
    return [line for line in lines if is_row(line)][-END_VALUES:]


def _rows(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield the rows with the byte that each begins at."""
    at = 0
    for line in file:
        if is_row(line):
            yield at, line
        at += len(line)


def _size(words: list[str]) -> tuple[int, int]:
    if len(words) == 2 and all(word.isdecimal() for word in words):
        return int(words[0]), int(words[1])
    return 0, 0
