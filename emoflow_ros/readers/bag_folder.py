"""Which files a bag is made of, what each of them is, and what was compressed.

A rosbag2 folder's metadata.yaml names its files. It may be missing, or name what was renamed or
unpacked since. What a file is, its first bytes say.
"""

import struct
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path, PurePath
from shutil import copyfileobj
from typing import NamedTuple

import yaml
from backports import zstd

from emoflow_ros.errors import InputError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_PACKED = (".zstd", ".zst")  # of rosbag2, and of the program zstd
_STORAGE_SUFFIXES = (".db3", ".mcap")
_PACKED_SUFFIXES = tuple(s + packed for s in _STORAGE_SUFFIXES for packed in _PACKED)
# rosbag names a bag .bag.active while it records.
_SUFFIXES = (".bag", ".bag.active", *_STORAGE_SUFFIXES, *_PACKED_SUFFIXES)
_SQLITE_HEADER = 100
_NOT_A_BAG = "give a ROS 1 .bag, a rosbag2 folder, an .mcap or a .db3 file"


class Storage(StrEnum):
    """Kinds of files that hold messages."""

    ROS1 = "ros1"
    SQLITE = "sqlite3"
    MCAP = "mcap"


_MAGIC = {
    b"#ROSBAG V": Storage.ROS1,
    b"SQLite format 3\0": Storage.SQLITE,
    b"\x89MCAP0\r\n": Storage.MCAP,
}


class BagFiles(NamedTuple):
    """The files of a bag in the order of recording, and what was unexpected about them."""

    files: list[Path]
    notes: list[str]


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: by its name or first bytes, or the files in its folder."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(_storage(path))
    return path.name.endswith(_SUFFIXES) or kind_of(_start(path)) is not None


def files_of(path: Path) -> BagFiles:
    """Find the files of a bag.

    Args:
        path: a file, or a rosbag2 folder.

    Raises:
        InputError: no such path, no bag, or a file is missing that metadata.yaml names and no
            other takes its place.
    """
    if path.is_file():
        return BagFiles([path], [])
    if not path.exists():
        raise InputError(path, "no such file or folder", "check the path")
    # name_0, name_1, ... name_10
    there = sorted(_storage(path), key=lambda f: (len(f.name), f.name))
    names = _names_in_metadata(path)
    if not there:
        wrong = f"{names[0]} is missing, which metadata.yaml names" if names else "not a bag"
        raise InputError(path, wrong, "copy it again" if names else _NOT_A_BAG)
    if not names:
        return BagFiles([f for f in there if not _is_packed_twin(f)], [])
    return _named_files(path, names, there)


def _named_files(path: Path, names: list[str], there: list[Path]) -> BagFiles:
    """Find the files that metadata.yaml names, or what lies in their place."""
    by_name = {f.name: f for f in there}
    forms = {n: [f for f in (n, *_other_forms(n)) if f in by_name] for n in names}
    twins = {n: by_name[found[0]] if found else None for n, found in forms.items()}
    missing = [n for n in names if twins[n] is None]
    taken = {form for n in names for form in forms[n]}
    spare = [f for f in there if f.name not in taken and not _is_packed_twin(f)]
    if missing and not (len(missing) == 1 and len(spare) == 1):
        lying = ", ".join(f.name for f in spare) or "no other"
        raise InputError(
            path,
            f"{', '.join(missing)} missing, which metadata.yaml names; there is {lying}",
            "copy what is missing, or give one of the files",
        )
    if missing:
        twins[missing[0]] = spare.pop()
    files = [(n, f) for n, f in twins.items() if f]
    notes = [
        f"metadata.yaml names {name}, which is not there; {file.name} is read in its place"
        for name, file in files
        if name != file.name
    ]
    if spare:
        lying = ", ".join(f.name for f in spare)
        notes.append(f"metadata.yaml does not name {lying}, which is left out")
    return BagFiles([file for _, file in files], notes)


def unpacked(file: Path, folder: Path) -> Path:
    """Unpack a compressed storage file into a folder; return the file itself if it is none.

    Raises:
        InputError: it cannot be unpacked.
    """
    if not _start(file).startswith(ZSTD_MAGIC):
        return file
    whole = folder / f"{len(list(folder.iterdir()))}_{_unpacked_name(file.name)}"
    try:
        with zstd.open(file, "rb") as packed, whole.open("wb") as out:
            copyfileobj(packed, out, 1 << 20)
    except (zstd.ZstdError, EOFError, ValueError) as error:
        reason = " ".join(str(error).split()).rstrip(".")
        raise InputError(file, f"damaged compression ({reason})", "copy it again") from None
    except OSError as error:
        reason = f"cannot be unpacked into {folder} ({error.strerror})"
        raise InputError(file, reason, "make room there, or set TMPDIR") from None
    return whole


def checked_kind(file: Path, name: Path) -> Storage:
    """Tell what a file is.

    Args:
        file: unpacked.
        name: of the file that the user knows, for errors.

    Raises:
        InputError: it is empty, cut off or no storage file.
    """
    try:
        with file.open("rb") as stream:
            start = stream.read(_SQLITE_HEADER)
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror})", "check the file") from None
    if not start:
        raise InputError(name, "empty file", "record or copy it again")
    kind = kind_of(start)
    if kind is None:
        raise InputError(name, "not a bag", _NOT_A_BAG)
    if kind is Storage.SQLITE and _sqlite_size(start) > file.stat().st_size:
        raise InputError(
            name, "damaged bag (truncated)", "repair it with 'ros2 bag reindex' or copy it again"
        )
    return kind


def kind_of(start: bytes) -> Storage | None:
    """Tell what a file is by its first bytes; None where it is no storage file."""
    return next((kind for magic, kind in _MAGIC.items() if start.startswith(magic)), None)


def _start(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            return stream.read(16)
    except OSError:  # `checked_kind` says so
        return b""


def _storage(folder: Path) -> Iterator[Path]:
    """Yield the storage files of a rosbag2 folder, without hidden ones: they are a system's own."""
    ends = (*_STORAGE_SUFFIXES, *_PACKED_SUFFIXES)
    for file in folder.iterdir():
        if file.name.endswith(ends) and not file.name.startswith(".") and file.is_file():
            yield file


def _names_in_metadata(folder: Path) -> list[str]:
    """Return the files that metadata.yaml names; none where it is missing or names none."""
    try:
        text = (folder / "metadata.yaml").read_text(encoding="utf-8")
        named = yaml.safe_load(text)["rosbag2_bagfile_information"]["relative_file_paths"]
        return [PurePath(name).name for name in named]
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError):
        return []


def _unpacked_name(name: str) -> str:
    for suffix in _PACKED:
        name = name.removesuffix(suffix)
    return name


def _other_forms(name: str) -> list[str]:
    """Return the names of the same file unpacked and packed, but its own."""
    plain = _unpacked_name(name)
    return [form for form in (plain, *(plain + suffix for suffix in _PACKED)) if form != name]


def _is_packed_twin(file: Path) -> bool:
    """Whether the same file lies unpacked beside a packed one."""
    plain = _unpacked_name(file.name)
    return plain != file.name and file.with_name(plain).is_file()


def _sqlite_size(header: bytes) -> int:
    """Bytes that a database says it has; SQLite reads missing ones as zeros (fileformat2)."""
    if len(header) < _SQLITE_HEADER:
        return _SQLITE_HEADER
    page, changes, pages, valid_for = struct.unpack_from(">16xH6xII60xI", header)
    return (65536 if page == 1 else page) * pages if changes == valid_for else 0
