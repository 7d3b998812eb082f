"""Columns of events in HDF5 files: data sets of their own, fields of one, columns of a table."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.readers.column_layout import COLUMN_NAMES, in_order, tell_layout
from emoflow_ros.readers.hdf5 import items_of

_NAMES = tuple(COLUMN_NAMES.values())
_TABLE_COLUMNS = 4
_SAMPLE = 1000
_EVENTS = "events"  # what a table of events is called


@dataclass(frozen=True)
class Column:
    """One column, read piece by piece.

    Attributes:
        data: the data set.
        part: the name of the field, or the number of the column in it; None where it is one
            column.
    """

    data: h5py.Dataset
    part: str | int | None = None

    @classmethod
    def of_table(cls, path: Path, table: h5py.Dataset, given: str) -> tuple[tuple[Self, ...], str]:
        """Return the columns x, y, t and p of a table without names, and their layout.

        Raises:
            InputError: see `tell_layout`.
        """
        if len(table) == 0:
            return tuple(cls(table, part) for part in range(_TABLE_COLUMNS)), ""
        ends = [table[:_SAMPLE], table[-1:]]
        layout = tell_layout(path, np.concatenate(ends).astype(np.float64), given)
        return tuple(cls(table, part) for part in in_order(layout)), layout

    @property
    def attributes(self) -> Any:
        """The data set's attributes, none of a table's."""
        return self.data.attrs if self.part is None else {}

    def __len__(self) -> int:
        return len(self.data)

    def __getitem__(self, rows: slice) -> NDArray[Any]:
        """Read rows, (M,)."""
        if isinstance(self.part, int):
            values = self.data[rows, self.part]
        elif self.part is not None:
            values = self.data[rows][self.part]
        else:
            values = self.data[rows]
        return np.ravel(values)


def columns_of(item: Any) -> tuple[Column, ...]:
    """Return the columns x, y, t and p of a group or a data set; nothing if one is missing."""
    if isinstance(item, h5py.Group):
        found = [_first(item, names) for names in _NAMES]
    elif isinstance(item, h5py.Dataset) and item.dtype.names and item.ndim == 1:
        parts = [next((n for n in names if n in item.dtype.names), None) for names in _NAMES]
        found = [None if part is None else Column(item, part) for part in parts]
    else:
        return ()
    columns = tuple(column for column in found if column is not None)
    return columns if len(columns) == len(_NAMES) else ()


def tables_of(file: h5py.File) -> list[str]:
    """List the tables (N, 4) of numbers: those that are called `events`, or else all."""
    tables = [name for name, item in items_of(file) if _is_table(item)]
    return [name for name in tables if name.rpartition("/")[2] == _EVENTS] or tables


def _first(group: h5py.Group, names: tuple[str, ...]) -> Column | None:
    """Return the first column of these names: (N,), or (N, 1) as some tools write it."""
    items = (group.get(name) for name in names)
    return next((Column(i) for i in items if isinstance(i, h5py.Dataset) and _is_one(i)), None)


def _is_table(item: Any) -> bool:
    is_numbers = isinstance(item, h5py.Dataset) and item.ndim == 2 and item.dtype.kind in "iuf"
    return is_numbers and bool(item.shape[1] == _TABLE_COLUMNS)


def _is_one(item: h5py.Dataset) -> bool:
    return item.dtype.names is None and (item.ndim == 1 or item.shape[1:] == (1,))
