"""A bag of any kind, opened and read without ROS."""

from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from heapq import merge
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, NoReturn, Protocol

from backports import zstd
from rosbags import rosbag1
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_typestore

from emoflow_ros.errors import InputError, say
from emoflow_ros.readers.bag_folder import ZSTD_MAGIC, Storage, checked_kind, files_of, unpacked
from emoflow_ros.readers.mcap_storage import McapStorage
from emoflow_ros.readers.unfinished_bags import finished_database, finished_ros1

_REPAIR = {
    Storage.ROS1: "repair it with 'rosbag reindex' or copy it again",
    Storage.SQLITE: "repair it with 'ros2 bag reindex' or copy it again",
    Storage.MCAP: "repair it with 'mcap recover' or copy it again",
}
_NO_MESSAGES = (1 << 63) - 1  # start of a storage without messages

type Item = tuple[Connection, int, bytes]


class _Storage(Protocol):
    connections: list[Connection]

    def messages(
        self, connections: list[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[Item]: ...


class Bag:
    """An opened bag: its connections and their messages.

    Message definitions are not needed: `msg_adapters` decodes events, and everything else that is
    read is of a standard type. An IDL schema or a type hash that differs does no harm therefore.

    Attributes:
        path: of the bag.
        kind: of its files.
        connections: one for each topic, type and serialisation, over all files and publishers.
        start_time, end_time: log times of the first message and behind the last one, ns; both 0
            without messages.
    """

    def __init__(
        self, path: Path, kind: Storage, storages: Sequence[tuple[_Storage, int, int]]
    ) -> None:
        self.path, self.kind = path, kind
        self._storages = [storage for storage, *_ in storages]
        self.connections: list[Connection] = []
        self._number: dict[tuple[str, str, str | None], int] = {}
        for storage in self._storages:
            for connection in storage.connections:
                self._add(connection)
        spans = [(start, end) for _, start, end in storages if start != _NO_MESSAGES]
        self.start_time = min((start for start, _ in spans), default=0)
        self.end_time = max((end for _, end in spans), default=0)

    @property
    def duration(self) -> int:
        """Time from the first message to the last one, ns."""
        return max(0, self.end_time - self.start_time)

    def messages(
        self,
        connections: Sequence[Connection] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[Item]:
        """Yield connection, log time in ns and bytes of messages in order of log time.

        Args:
            connections: whose; those of all if none are given.
            start, stop: leave out what was logged before the one, and from the other on, ns.

        Raises:
            Exception: of any kind, from damaged data; `read_messages` makes one line of it.
        """
        wanted = {c.id for c in connections or self.connections}
        streams = []
        for storage in self._storages:
            own = [c for c in storage.connections if self._number[_key(c)] in wanted]
            if own:
                streams.append(storage.messages(own, start, stop))
        for found, logged, data in merge(*streams, key=lambda item: item[1]):
            connection = self.connections[self._number[_key(found)]]
            if connection.id not in wanted:
                raise ValueError("a message of another topic than its index says")
            yield connection, logged, self._plain(connection, bytes(data))

    def _add(self, connection: Connection) -> None:
        key = _key(connection)
        number = self._number.setdefault(key, len(self.connections))
        if number == len(self.connections):
            self.connections.append(connection._replace(id=number, owner=self))
        else:
            first = self.connections[number]
            count = first.msgcount + connection.msgcount
            self.connections[number] = first._replace(msgcount=count)

    def _plain(self, connection: Connection, data: bytes) -> bytes:
        """Decompress a message that is compressed; none in CDR begins with these bytes."""
        if not data.startswith(ZSTD_MAGIC) or serialization(connection) != "cdr":
            return data
        say(self.path, "its messages are compressed one by one (zstd)")
        return bytes(zstd.decompress(data))


@contextmanager
def open_bag(path: Path) -> Generator[Bag]:
    """Open a bag of any kind: a ROS 1 file, a rosbag2 folder, or a single storage file.

    A rosbag2 folder without metadata is read from its storage files, a compressed one from an
    unpacked copy. A file that was cut off while recording is read as far as it is whole. A line on
    standard error says what was not as it should be.

    Raises:
        InputError: the file is missing, empty, damaged or not a bag.
    """
    files, notes = files_of(path)
    for note in notes:
        say(path, note)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        storages = [_opened(file, folder, stack) for file in files]
        yield Bag(path, storages[0][0], [(s, start, end) for _, s, start, end in storages])


def _opened(file: Path, folder: Path, stack: ExitStack) -> tuple[Storage, _Storage, int, int]:
    """Open a storage file; return its kind, itself and its log times, ns."""
    plain = unpacked(file, folder)
    kind = checked_kind(plain, file)
    storage: Any
    # On damaged bytes any exception of the libraries below may come.
    try:
        if kind is Storage.ROS1:
            instead = finished_ros1(plain)
            storage = rosbag1.Reader(instead or plain)
        elif kind is Storage.SQLITE:
            instead = finished_database(plain, folder)
            storage = Sqlite3Reader(instead or plain)
        else:
            storage, instead = McapStorage(plain), None
        storage.open()
    except Exception as error:
        _refuse(file, error, _REPAIR[kind])
    stack.callback(storage.close)
    times = storage if kind is Storage.ROS1 else storage.metadata
    if instead or (kind is Storage.MCAP and storage.is_cut):
        count = sum(connection.msgcount for connection in storage.connections)
        seconds = max(0, times.end_time - times.start_time) / 1e9
        say(
            file,
            f"cut off while recording; read as far as it is whole: {count} messages in "
            f"{seconds:.1f} s",
        )
    return kind, storage, times.start_time, times.end_time


def read_messages(
    path: Path, bag: Bag, connections: list[Connection], start: int | None = None
) -> Iterator[Item]:
    """Stream (connection, log time in ns, bytes) of an opened bag in order of log time.

    With `start` only what was logged at or after that time, ns.

    Raises:
        InputError: damaged data, or no message of a connection although the bag says that there
            are some.
    """
    messages = bag.messages(connections, start)
    seen: set[int] = set()
    while True:
        try:
            item = next(messages)
        except StopIteration:
            break
        except Exception as error:
            _refuse(path, error, _REPAIR[bag.kind])
        seen.add(item[0].id)
        yield item
    lost = [c for c in connections if c.msgcount and c.id not in seen]
    if lost and start is None:
        topics, count = ", ".join(sorted({c.topic for c in lost})), sum(c.msgcount for c in lost)
        raise InputError(
            path,
            f"damaged bag (it says that it holds {count} messages on {topics}, and none is there)",
            _REPAIR[bag.kind],
        )


def serialization(connection: Connection) -> Literal["cdr", "ros1"] | None:
    """Return how messages are serialised, as `make_decoder` takes it; None: in another way."""
    if not isinstance(connection.ext, ConnectionExtRosbag2):
        return "ros1"
    known: dict[str, Literal["cdr", "ros1"]] = {"cdr": "cdr", "ros1": "ros1"}
    return known.get(connection.ext.serialization_format)


def deserialize(bag: Bag, connection: Connection, data: bytes) -> Any:
    """Deserialise a message of any type but the event types, which `msg_adapters` decode.

    Raises:
        InputError: damaged data, or of no type that is known.
    """
    store = _typestore(serialization(connection) == "ros1")
    try:
        if serialization(connection) == "ros1":
            return store.deserialize_ros1(data, connection.msgtype)
        return store.deserialize_cdr(data, connection.msgtype)
    except Exception as error:  # any, as when it is opened
        _refuse(bag.path, error, _REPAIR[bag.kind])


def _key(connection: Connection) -> tuple[str, str, str | None]:
    return connection.topic, connection.msgtype, serialization(connection)


@cache
def _typestore(ros1: bool) -> Any:
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)


def _refuse(file: Path, error: BaseException, fix: str) -> NoReturn:
    """Raise the InputError of a bag that cannot be read, with what can be done about it."""
    reason = " ".join(str(error).split()) or type(error).__name__
    raise InputError(file, f"damaged bag ({reason.rstrip('.')})", fix) from None
