"""The files of a bag: which there are, and what can be seen of them before they are read."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import yaml

from emoflow_ros.errors import InputError

_STORAGE_SUFFIXES = (".db3", ".mcap")
MAGIC = {".bag": b"#ROSBAG V", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
_SQLITE_HEADER = 100
_REPAIR = {
    ".bag": "repair it with 'rosbag reindex' or copy it again",
    ".db3": "repair it with 'ros2 bag reindex' or copy it again",
    ".mcap": "repair it with 'mcap recover' or copy it again",
}


def storage(folder: Path) -> Iterator[Path]:
    """Yield the storage files of a rosbag2 folder."""
    if folder.is_dir():
        yield from (f for f in folder.iterdir() if f.suffix in _STORAGE_SUFFIXES)


def storage_files(folder: Path) -> list[Path]:
    """List the storage files in the order of recording (`name_0`, `name_1`, ... `name_10`).

    Raises:
        InputError: no such folder, or it is no bag.
    """
    if not folder.exists():
        raise InputError(folder, "no such file or folder", "check the path")
    files = sorted(storage(folder), key=lambda f: (len(f.name), f.name))
    if not files and not (folder / "metadata.yaml").is_file():
        raise InputError(folder, "not a bag", "give a ROS 1 .bag, a rosbag2 folder, .mcap or .db3")
    return files or [folder]


def check_magic(file: Path) -> None:
    """Refuse a storage file that is empty, cut off, or none.

    Raises:
        InputError: it is.
    """
    if file.is_dir():  # a folder of compressed storage files
        return
    magic = MAGIC.get(file.suffix)
    try:
        with file.open("rb") as stream:
            start = stream.read(_SQLITE_HEADER)
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})", "check the file") from None
    if not start:
        raise InputError(file, "empty file", "record or copy it again")
    if magic is None or not start.startswith(magic):
        raise InputError(
            file, "not a bag", "give a ROS 1 .bag, a rosbag2 folder, an .mcap or a .db3 file"
        )
    if file.suffix == ".db3" and _sqlite_size(start) > file.stat().st_size:
        refuse(file, EOFError("truncated"))


def _sqlite_size(header: bytes) -> int:
    """Bytes that a database says it has; SQLite reads missing ones as zeros (fileformat2)."""
    if len(header) < _SQLITE_HEADER:
        return _SQLITE_HEADER
    page, changes, pages, valid_for = struct.unpack_from(">16xH6xII60xI", header)
    return (65536 if page == 1 else page) * pages if changes == valid_for else 0


def has_usable_metadata(path: Path) -> bool:
    """Whether metadata.yaml names its storage; some recorders leave that empty."""
    if path.is_file():
        return True
    try:
        metadata = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
        return bool(metadata["rosbag2_bagfile_information"]["storage_identifier"])
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError):
        return False


def refuse(file: Path, error: BaseException) -> NoReturn:
    """Raise the InputError of a bag that cannot be read, with what can be done about it."""
    reason = " ".join(str(error).split()) or type(error).__name__
    fix = _REPAIR.get(file.suffix, "repair it with 'ros2 bag reindex' or copy it again")
    raise InputError(file, f"damaged bag ({reason.rstrip('.')})", fix) from None
