"""Reader of bags: ROS 1 files and rosbag2 (sqlite3, mcap), without ROS."""

import struct
from collections.abc import Generator, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

import yaml
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from emoflow_ros.core.calibration import load_calibration
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.bag_entry import log_time_before
from emoflow_ros.offline.readers.bag_imu import choose_imu, read_imu
from emoflow_ros.offline.readers.base import StreamCheck, trimmed
from emoflow_ros.offline.readers.imu import Imu
from msg_adapters import DecodeError, EventMessage, make_decoder, supported_types

_STORAGE_SUFFIXES = (".db3", ".mcap")
_MAGIC = {".bag": b"#ROSBAG V", ".db3": b"SQLite format 3\0", ".mcap": b"\x89MCAP0\r\n"}
_SQLITE_HEADER = 100
_ANY_SIZE = 1 << 16  # of an unknown sensor: coordinates are 16-bit
_STANDALONE = "/EventArray"  # times do not depend on messages before
_REPAIR = {
    ".bag": "repair it with 'rosbag reindex' or copy it again",
    ".db3": "repair it with 'ros2 bag reindex' or copy it again",
    ".mcap": "repair it with 'mcap recover' or copy it again",
}


class BagRecording:
    """The event topic of a bag, with the camera_info beside it."""

    FORMAT = "a bag (ROS 1 .bag, rosbag2 folder, .mcap, .db3)"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        self.path = path
        with ExitStack() as stack:
            self._bag = stack.enter_context(open_bag(path))
            self._connection = _event_connection(path, self._bag, topic)
            self.topic = self._connection.topic
            self.camera = (
                load_calibration(calibration) if calibration else self._camera_beside_events()
            )
            self.duration: float | None = self._bag.duration / NS_PER_S
            self._stack = stack.pop_all()

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path looks like a bag: by its suffix, or a folder with storage files."""
        return path.suffix in _MAGIC or (path / "metadata.yaml").is_file() or any(_storage(path))

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, one message at a time."""
        start = None
        if since is not None and self._connection.msgtype.endswith(_STANDALONE):
            start = log_time_before(since, self._first_event)
        return trimmed(self._checked(start), since)

    def _checked(self, start: int | None) -> Iterator[Events]:
        check: StreamCheck | None = None
        for _, message in self._decode(start):
            if check is None:
                check = StreamCheck(self.path, *self._sensor_size(message.width, message.height))
            yield check(message.events, message.dropped_outside)
        if check is None:
            raise InputError(self.path, f"no messages on {self.topic}", "record it again")
        check.finish()

    def _decode(self, start: int | None) -> Iterator[tuple[int, EventMessage]]:
        """Decode the messages logged at or after a time in ns, each with its log time."""
        decoder = make_decoder(self._connection.msgtype, serialization(self._bag))
        for _, logged, data in read_messages(self.path, self._bag, [self._connection], start):
            try:
                yield logged, decoder.decode(data)
            except DecodeError as error:
                raise InputError(
                    self.path, f"damaged message on {self.topic} ({error})", "record it again"
                ) from None

    def _first_event(self, start: int | None) -> tuple[int, int] | None:
        """Log and event time of the first event logged at or after a time, ns."""
        for logged, message in self._decode(start):
            if len(message.events):
                return logged, int(message.events.t[0])
        return None

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read an IMU topic; see Recording."""
        connections = choose_imu(self.path, self._bag.connections, self.topic, topic)
        if not connections:
            return None
        return read_imu(
            self.path, read_messages(self.path, self._bag, connections), ros2=self._bag.is2
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def _sensor_size(self, width: int, height: int) -> tuple[int, int]:
        """Reconcile the size in the messages (0: none) with the camera's."""
        if self.camera is None:
            return width or _ANY_SIZE, height or _ANY_SIZE
        size = self.camera.width, self.camera.height
        if width and (width, height) != size:
            raise InputError(
                self.path,
                f"events of a {width}x{height} sensor with the calibration of a "
                f"{size[0]}x{size[1]} one",
                "give this sensor's calibration with --calib FILE",
            )
        return size

    def _camera_beside_events(self) -> Camera | None:
        """Read the first message of the camera_info topic in the event topic's namespace."""
        name = self.topic.rpartition("/")[0] + "/camera_info"
        found = [c for c in self._bag.connections if c.topic == name]
        for connection, _, data in read_messages(self.path, self._bag, found) if found else ():
            info = deserialize(self._bag, connection, data)
            k, d = (info.K, info.D) if hasattr(info, "K") else (info.k, info.d)
            return Camera.from_intrinsic_matrix(
                info.width, info.height, k, info.distortion_model, d
            )
        return None


class _StandardTypesReader(AnyReader):
    """An AnyReader that knows the standard message types and ignores the bag's definitions.

    Events are decoded by `msg_adapters` and everything else that is read here is a standard
    type, so definitions are not needed, and an IDL schema, which AnyReader cannot parse, or a
    type hash that differs does no harm.
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
    read from its storage files.

    Raises:
        InputError: the file is missing, empty, truncated, not indexed or not a bag.
    """
    files = [path] if path.is_file() else _storage_files(path)
    for file in files:
        _check_magic(file)
    sources = [path] if _has_usable_metadata(path) else files
    store = get_typestore(Stores.ROS1_NOETIC if path.suffix == ".bag" else Stores.ROS2_JAZZY)
    with ExitStack() as stack:
        # On damaged bytes rosbags passes on whatever the libraries below it raise.
        try:
            reader = stack.enter_context(_StandardTypesReader(sources, default_typestore=store))
        except Exception as error:
            _refuse(files[0], error)
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
    """Deserialise a message of any type but the event types, which `msg_adapters` decode."""
    return reader.deserialize(data, connection.msgtype)


def _event_connection(path: Path, reader: AnyReader, topic: str | None) -> Connection:
    """Find the one event topic, or the one asked for."""
    known = {c.topic: c for c in reader.connections if c.msgtype in supported_types()}
    if topic is not None:
        if topic in known:
            return known[topic]
        wrong = f"no event topic '{topic}'"
    elif len(known) == 1:
        return next(iter(known.values()))
    elif known:
        raise InputError(
            path, f"{len(known)} event topics: {', '.join(sorted(known))}", "choose with --topic"
        )
    else:
        wrong = "no event topic"
    there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections}))
    fix = f"give one of {', '.join(sorted(known))}" if known else "give a bag with events"
    raise InputError(path, f"{wrong}; it holds {there or 'no topics'}", fix)


def _storage(folder: Path) -> Iterator[Path]:
    """Yield the storage files of a rosbag2 folder."""
    if folder.is_dir():
        yield from (f for f in folder.iterdir() if f.suffix in _STORAGE_SUFFIXES)


def _storage_files(folder: Path) -> list[Path]:
    """List the storage files in the order of recording (`name_0`, `name_1`, ... `name_10`)."""
    if not folder.exists():
        raise InputError(folder, "no such file or folder", "check the path")
    files = sorted(_storage(folder), key=lambda f: (len(f.name), f.name))
    if not files and not (folder / "metadata.yaml").is_file():
        raise InputError(folder, "not a bag", "give a ROS 1 .bag, a rosbag2 folder, .mcap or .db3")
    return files or [folder]


def _check_magic(file: Path) -> None:
    if file.is_dir():  # a folder of compressed storage files
        return
    magic = _MAGIC.get(file.suffix)
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
    reason = " ".join(str(error).split()) or type(error).__name__
    fix = _REPAIR.get(file.suffix, "repair it with 'ros2 bag reindex' or copy it again")
    raise InputError(file, f"damaged bag ({reason.rstrip('.')})", fix) from None
