"""What is said of a path that is no recording: what was found there, and what to do."""

from pathlib import Path
from typing import NoReturn

import h5py

from emoflow_ros.errors import InputError
from emoflow_ros.readers.hdf5 import damage_refused, is_hdf5, items_of, open_hdf5

_MOST_NAMES = 6
# Files that are known, but not read, by what they are called.
_OTHERS = {
    ".dat": (
        "a Prophesee .dat file, which is not read",
        "convert it with Metavision's metavision_file_to_hdf5",
    ),
    ".aedat": ("an AEDAT 1 to 3 file, which is not read", "convert it to AEDAT4 with DV"),
    ".aedat2": ("an AEDAT 2 file, which is not read", "convert it to AEDAT4 with DV"),
    ".bin": ("a binary file of no known format", "convert it to columns t x y p as text"),
    ".mat": ("a MATLAB file, which is not read", "save x, y, t and p as .npz or HDF5"),
    ".zip": ("an archive", "unpack it"),
    ".gz": ("a compressed file", "unpack it"),
    ".tar": ("an archive", "unpack it"),
    ".7z": ("an archive", "unpack it"),
    ".yaml": ("a YAML file, no recording", "give a calibration with --calib FILE"),
    ".yml": ("a YAML file, no recording", "give a calibration with --calib FILE"),
}


def refuse_unknown(path: Path, known_formats: str) -> NoReturn:
    """Raise the InputError of a path that no reader takes.

    Args:
        path: an existing file or folder.
        known_formats: what could be given.
    """
    found, fix = _describe(path)
    raise InputError(path, found, fix or f"give {known_formats}")


def _describe(path: Path) -> tuple[str, str]:
    if path.is_dir():
        return f"not a recording of a known format: a folder with {_listed(path)}", ""
    if path.is_file() and path.stat().st_size == 0:
        return "an empty file", "record or copy it again"
    if is_hdf5(path):
        return (
            f"an HDF5 file without columns of events; it holds {_data_sets(path)}",
            "give data sets x, y, t and p of equal length in one group, or a table (N, 4)",
        )
    if path.suffix.lower() in _OTHERS:
        return _OTHERS[path.suffix.lower()]
    kind = f"a '{path.suffix}' file" if path.suffix else "a file without a suffix"
    return f"not a recording of a known format: {kind}", ""


def _listed(folder: Path) -> str:
    return _some(sorted(p.name for p in folder.iterdir())) or "nothing in it"


def _data_sets(path: Path) -> str:
    with open_hdf5(path) as file, damage_refused(path):
        items = [(name, item) for name, item in items_of(file) if isinstance(item, h5py.Dataset)]
        return _some([f"{name} {item.shape}" for name, item in items]) or "nothing"


def _some(names: list[str]) -> str:
    more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    return ", ".join(names[:_MOST_NAMES]) + more
