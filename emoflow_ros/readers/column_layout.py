"""Which column of a table is x, y, t and p, in text files and arrays."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import permutations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.errors import InputError

type Pixels = Callable[[NDArray[np.float64], NDArray[np.float64]], bool]

_LETTERS = "xytp"
SKIPPED = "-"
USUAL_LAYOUT = "txyp"
_COMMON = (USUAL_LAYOUT, "xytp", "xypt")
_ALL = (
    *_COMMON,
    *(
        layout
        for layout in map("".join, permutations(_LETTERS))
        if layout.index("x") < layout.index("y") and layout not in _COMMON
    ),
)
_LARGEST_SENSOR = 4096  # px a side
_LARGEST_COORDINATE = 1 << 16
_SHARE = 0.9  # of the rows that a column's meaning has to hold for
# The names that data sets and tools give each column.
COLUMN_NAMES = {
    "x": ("x", "xs"),
    "y": ("y", "ys"),
    "t": ("t", "ts", "time", "timestamp", "timestamps"),
    "p": ("p", "ps", "pol", "polarity", "polarities"),
}
_ALIASES = {name: letter for letter, names in COLUMN_NAMES.items() for name in names}


@dataclass(frozen=True)
class ColumnOptions:
    """What the user says of a recording's columns, where the file does not.

    Attributes:
        layout: a letter of each column in their order, x, y, t and p, `-` for others; empty: told
            by the values.
        time_unit: s, ms, us or ns; empty: told by the values.
    """

    layout: str = ""
    time_unit: str = ""

    def __bool__(self) -> bool:
        return bool(self.layout or self.time_unit)


def tell_layout(path: Path, rows: NDArray[np.float64], given: str = "") -> str:
    """Return a letter of each column of a table.

    A column of times grows, one of polarities holds 0 and 1 or -1 and 1, and pixels are whole
    numbers below 4096, x before y. Of several layouts that fit, the most common one counts.

    Args:
        path: the file, for errors.
        rows: (M, columns) the table's first rows, M > 0.
        given: the layout by the user or a header; empty to tell it by the values.

    Raises:
        InputError: no layout fits, or the one given does not have these columns.
    """
    columns = rows.shape[1]
    if given:
        if len(given) != columns:
            raise InputError(
                path,
                f"lines of {columns} numbers with the layout '{given}'",
                f"give --layout a letter of each column: x, y, t, p, and {SKIPPED} for others",
            )
        return given
    if columns != len(_LETTERS):
        raise InputError(
            path,
            f"lines of {columns} numbers",
            "a line is 't x y p'; name other columns with --layout",
        )
    layout = next(_fitting(rows), None)
    if layout is None:
        ranges = ", ".join(f"{low:g} to {high:g}" for low, high in zip(*_range(rows), strict=True))
        raise InputError(
            path,
            f"its columns ({ranges}) are not events: time that grows, pixels and polarity",
            "say which column is which with --layout, for example xytp",
        )
    return layout


def layout_of_names(names: list[str]) -> str:
    """Return the layout that a line of names gives; empty where it does not name all of them."""
    letters = [_ALIASES.get(name.lower().strip('"[]()').split("_")[0], SKIPPED) for name in names]
    return "".join(letters) if is_layout("".join(letters)) else ""


def is_layout(text: str) -> bool:
    """Whether a text names each of x, y, t and p once, and nothing else but columns to skip."""
    return sorted(text.replace(SKIPPED, "")) == sorted(_LETTERS)


def in_order(layout: str) -> list[int]:
    """Return the columns of x, y, t and p."""
    return [layout.index(letter) for letter in _LETTERS]


def _range(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return rows.min(axis=0), rows.max(axis=0)


def _fitting(rows: NDArray[np.float64]) -> Iterator[str]:
    """Yield the layouts that fit, the most likely first."""

    def fits(layout: str, must_grow: bool, are_pixels: Pixels = _are_pixels) -> bool:
        x, y, t, p = rows[:, in_order(layout)].T
        return _is_polarity(p) and are_pixels(x, y) and _is_time(t, must_grow)

    yield from (layout for layout in _COMMON if fits(layout, True))
    # Pixels outside, or with decimals, are judged where they are read.
    yield from (layout for layout in (USUAL_LAYOUT,) if fits(layout, True, _are_coordinates))
    yield from (layout for layout in _ALL if fits(layout, True))
    yield from (layout for layout in _ALL if fits(layout, False))
    x, y, _, p = rows[:, in_order(USUAL_LAYOUT)].T  # and so are times that go back
    if _is_polarity(p) and _are_coordinates(x, y):
        yield USUAL_LAYOUT


def _is_polarity(p: NDArray[np.float64]) -> bool:
    return bool(np.isin(p, (0.0, 1.0)).all() or np.isin(p, (-1.0, 1.0)).all())


def _are_pixels(x: NDArray[np.float64], y: NDArray[np.float64]) -> bool:
    values = np.stack([x, y])
    fits = (values >= 0) & (values < _LARGEST_SENSOR) & (values == np.rint(values))
    return bool(fits.all(axis=0).mean() >= _SHARE)


def _are_coordinates(x: NDArray[np.float64], y: NDArray[np.float64]) -> bool:
    return bool((np.abs([x, y]) < _LARGEST_COORDINATE).all())


def _is_time(t: NDArray[np.float64], must_grow: bool) -> bool:
    if must_grow and not t[-1] > t[0]:
        return False
    return len(t) < 2 or bool((np.diff(t) >= 0).mean() >= _SHARE)
