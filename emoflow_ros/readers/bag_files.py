"""The files of a bag of any kind: how they are checked, opened and read without ROS.

Messages of ROS 1 can be converted to the CDR bytes that ROS 2 publishes.
"""

import struct
import sys
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NoReturn

import numpy as np
import yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from emoflow_ros.core.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.unfinished_bags import finished

_STORAGE_SUFFIXES = (".db3", ".mcap")
MAGIC = {".bag": b"#ROSBAG V", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
_SQLITE_HEADER = 100
_REPAIR = {
    ".bag": "repair it with 'rosbag reindex' or copy it again",
    ".db3": "repair it with 'ros2 bag reindex' or copy it again",
    ".mcap": "repair it with 'mcap recover' or copy it again",
}

# Header header, uint32 height, uint32 width, Event[] events
_EVENT_ARRAYS = ("dvs_msgs/msg/EventArray", "prophesee_event_msgs/msg/EventArray")
_FRAME_ID_AT = 12  # after sequence number and stamp
_ROS1_EVENT = 13
_CDR_EVENT = 16


def storage(folder: Path) -> Iterator[Path]:
    """Yield the storage files of a rosbag2 folder."""
    if folder.is_dir():
        yield from (f for f in folder.iterdir() if f.suffix in _STORAGE_SUFFIXES)


def _storage_files(folder: Path) -> list[Path]:
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


def _check_magic(file: Path) -> None:
    """Refuse what is empty, cut off or no storage file.

    Raises:
        InputError: the file cannot be used.
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
        _refuse(file, EOFError("truncated"))


def _sqlite_size(header: bytes) -> int:
    """Bytes that a database says it has; SQLite reads missing ones as zeros (fileformat2)."""
    if len(header) < _SQLITE_HEADER:
        return _SQLITE_HEADER
    page, changes, pages, valid_for = struct.unpack_from(">16xH6xII60xI", header)
    return (65536 if page == 1 else page) * pages if changes == valid_for else 0


def _has_usable_metadata(path: Path) -> bool:
    """Whether metadata.yaml names its storage; some recorders leave that empty."""
    if path.is_file():
        return True
    try:
        metadata = yaml.safe_load((path / "metadata.yaml").read_text(encoding="utf-8"))
        return bool(metadata["rosbag2_bagfile_information"]["storage_identifier"])
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError):
        return False


def _refuse(file: Path, error: BaseException) -> NoReturn:
    """Raise the InputError of a bag that cannot be read, with what can be done about it."""
    reason = " ".join(str(error).split()) or type(error).__name__
    fix = _REPAIR.get(file.suffix, "repair it with 'ros2 bag reindex' or copy it again")
    raise InputError(file, f"damaged bag ({reason.rstrip('.')})", fix) from None


class _StandardTypesReader(AnyReader):
    """An AnyReader that knows the standard message types and ignores the bag's definitions.

    Definitions are not needed: `msg_adapters` decodes events, and everything else that is read
    here is of a standard type. An IDL schema, which AnyReader cannot parse, or a type hash that
    differs does no harm therefore.
    """

    def open(self) -> None:
        """Open all files, or none."""
        self.stack = ExitStack()
        try:
            for reader in self.readers:
                self.stack.enter_context(reader)
        except BaseException:
            self.close()
            raise
        self.connections = [c for reader in self.readers for c in reader.connections]
        assert self.default_typestore is not None
        self.typestore = self.default_typestore


@contextmanager
def open_bag(path: Path) -> Generator[AnyReader]:
    """Open a bag of any kind: a ROS 1 file, a rosbag2 folder, or a single storage file.

    A rosbag2 folder without usable metadata (recorder killed, empty storage_identifier) is
    read from its storage files. A file that was cut off while recording is read as far as it is
    whole. A line on standard error says how far that is.

    Raises:
        InputError: the file is missing, empty, truncated, not indexed or not a bag.
    """
    files = [path] if path.is_file() else _storage_files(path)
    store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_JAZZY)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        instead = {file: finished(file, folder) for file in files}
        for file in files:
            _check_magic(instead[file] or file)
        cut = [file for file in files if instead[file]]
        whole = not cut and _has_usable_metadata(path)
        sources = [path] if whole else [instead[file] or file for file in files]
        # On damaged bytes rosbags passes on any exception of the libraries below it.
        try:
            reader = stack.enter_context(_StandardTypesReader(sources, default_typestore=store))
        except Exception as error:
            _refuse(files[0], error)
        if cut:
            count = sum(connection.msgcount for connection in reader.connections)
            seconds = reader.duration / NS_PER_S
            files_cut = ", ".join(map(str, cut))
            print(
                f"{files_cut}: cut off while recording; read as far as it is whole: {count} "
                f"messages in {seconds:.1f} s",
                file=sys.stderr,
            )
        yield reader


def read_messages(
    path: Path, reader: AnyReader, connections: list[Connection], start: int | None = None
) -> Iterator[tuple[Connection, int, bytes]]:
    """Stream (connection, log time in ns, bytes) of an opened bag in order of log time.

    With `start` only what was logged at or after that time, ns.

    Raises:
        InputError: damaged data.
    """
    messages = reader.messages(connections=connections, start=start)
    while True:
        try:
            item = next(messages)
        except StopIteration:
            return
        except Exception as error:
            _refuse(path, error)
        yield item


def serialization(reader: AnyReader) -> Any:
    """Return `cdr` or `ros1`, as `msg_adapters.make_decoder` takes it."""
    return "cdr" if reader.is2 else "ros1"


def deserialize(reader: AnyReader, connection: Connection, data: bytes) -> Any:
    """Deserialise a message of any type but the event types, which `msg_adapters` decode.

    Raises:
        InputError: damaged data.
    """
    try:
        return reader.deserialize(data, connection.msgtype)
    except Exception as error:  # any, as when it is opened
        _refuse(Path(str(reader.paths[0])), error)


class Ros1Converter:
    """Converts the serialised messages of a ROS 1 bag.

    Args:
        connections: of the bag; they define the types that are not standard.
    """

    def __init__(self, connections: list[Connection]) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        for connection in connections:
            try:
                types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            except TypesysError:
                continue  # `to_cdr` says so, if the topic is wanted
            self._store.register({k: v for k, v in types.items() if k not in self._store.fielddefs})

    def to_cdr(self, data: bytes, msgtype: str) -> bytes:
        """Convert one message.

        Raises:
            InputError: the message is damaged or of a type that is not defined.
        """
        try:
            if msgtype in _EVENT_ARRAYS:
                return self._event_array(data, msgtype)
            return bytes(self._store.ros1_to_cdr(data, msgtype))
        except (SerdeError, TypesysError, KeyError, ValueError, struct.error) as error:
            reason = " ".join(str(error).split()).rstrip(".")
            raise InputError(
                msgtype, f"message cannot be converted ({reason})", "leave it out with --topics"
            ) from None

    def _event_array(self, data: bytes, msgtype: str) -> bytes:
        (frame_id_size,) = struct.unpack_from("<I", data, _FRAME_ID_AT)
        count_at = _FRAME_ID_AT + 4 + frame_id_size + 8
        (count,) = struct.unpack_from("<I", data, count_at)
        records = np.frombuffer(data, np.uint8, offset=count_at + 4).reshape(count, _ROS1_EVENT)
        # A message without events ends in their count.
        empty = self._store.ros1_to_cdr(data[:count_at] + bytes(4), msgtype)
        return b"".join([empty[:-4], struct.pack("<I", count), _cdr_events(records)])


def _cdr_events(records: np.ndarray[tuple[int, int], np.dtype[np.uint8]]) -> bytes:
    """Spread packed events (N, 13) as CDR aligns them.

    CDR aligns each member, not the struct: x of every event but the first comes one byte of
    padding after the polarity before it, and two more precede its time. The rows below
    therefore start 2 bytes before the first event, whose x and y have no such gap behind them.
    """
    rows = np.zeros((len(records), _CDR_EVENT), np.uint8)
    rows[:, 0:4] = records[:, 0:4]  # x, y
    rows[:, 6:15] = records[:, 4:13]  # seconds, nanoseconds, polarity
    spread = rows.reshape(-1)[2:-1]
    spread[:4] = records[:1, :4].reshape(-1)
    return spread.tobytes()
