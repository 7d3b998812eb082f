"""What the readers of HDF5 data sets share: a file is opened, and its damage is refused."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import h5py

from emoflow_ros.errors import InputError
from emoflow_ros.readers.search_in_time import first_since

try:  # optional: it registers the compressions that data sets use
    import hdf5plugin  # noqa: F401

    _ADD_COMPRESSION = "install its HDF5 plugin"
except ImportError:
    _ADD_COMPRESSION = "run 'pip install hdf5plugin'"

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
CHUNK = 1_000_000  # events
# What h5py passes on of a file whose inner structure is damaged.
_DAMAGED = (OSError, KeyError, RuntimeError, ValueError, TypeError, AttributeError)


def is_hdf5(path: Path) -> bool:
    """Whether the path is a file that starts like HDF5."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_SIGNATURE)) == _SIGNATURE


def open_hdf5(path: Path) -> h5py.File:
    """Open a file for reading.

    Raises:
        InputError: the file is damaged.
    """
    try:
        return h5py.File(path, "r")
    except OSError as error:
        refuse(path, error)


def holds(path: Path, names: Sequence[str]) -> bool:
    """Whether the path is an HDF5 file with data sets of these names."""
    if not is_hdf5(path):
        return False
    with open_hdf5(path) as file, damage_refused(path):
        return all(isinstance(file.get(name), h5py.Dataset) for name in names)


@contextmanager
def damage_refused(path: Path) -> Iterator[None]:
    """Turn what h5py raises while a damaged file is read into an InputError.

    Raises:
        InputError: the file is damaged, or compressed in a way that is not installed.
    """
    try:
        yield
    except _DAMAGED as error:
        refuse(path, error)


def items_of(file: h5py.File) -> list[tuple[str, Any]]:
    """List the groups and data sets of a file by name, without those whose names are no text."""
    found: list[tuple[str, Any]] = []

    def visit(name: str | bytes, item: Any) -> None:
        if isinstance(name, str):  # bytes that are no UTF-8 stay bytes
            found.append((name, item))

    file.visititems(visit)
    return found


def row_before(rows: int, time: Callable[[int], int], since: int | None) -> int:
    """Find the last row before a time, by bisection; row 0 where there is none.

    Args:
        rows: how many there are, in order of time but for single ones.
        time: the time of a row, ns.
        since: the time, ns; None for row 0.
    """
    return 0 if since is None else max(0, first_since(0, rows, time, since) - 1)


def refuse(path: Path, error: Exception) -> NoReturn:
    """Raise the InputError of a file that cannot be read."""
    if names := _compressions_not_installed(path):
        raise InputError(
            path,
            f"compressed with {', '.join(names)}, which the installed libraries cannot read",
            _ADD_COMPRESSION,
        ) from None
    reason = " ".join(str(error).split())
    raise InputError(path, f"damaged HDF5 file ({reason})", "copy it again") from None


def _compressions_not_installed(path: Path) -> list[str]:
    """Name the compressions that no library here reads; nothing where damage hides them."""
    names: set[str] = set()

    def visit(_: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset):
            creation = item.id.get_create_plist()
            for k in range(creation.get_nfilters()):
                code, _, _, name = creation.get_filter(k)
                if not h5py.h5z.filter_avail(code):
                    names.add(name.decode(errors="replace").split(";")[0] or f"filter {code}")

    with suppress(*_DAMAGED), h5py.File(path, "r") as file:
        file.visititems(visit)
    return sorted(names)
