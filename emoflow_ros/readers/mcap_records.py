"""The records of an MCAP file: where they are, and what those that readers need hold.

Source: MCAP specification, https://mcap.dev/spec. A record is a byte that says its kind, the length
of its content in 8 bytes, and the content. All numbers are little endian.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, NamedTuple

from rosbags.rosbag2.storage_mcap import decompress

MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_FOOTER = struct.Struct("<BQQQI")
_STATISTICS = struct.Struct("<QHIIIIQQ")
MESSAGE_HEAD, CHUNK_HEAD, INDEX_HEAD = _MESSAGE.size, _CHUNK.size, 6
_INDEX_HEAD = _HEAD.size + 6  # of a message index: the record's, channel and length of the list
_INDEX_ENTRY = 16


class Kind(IntEnum):
    """Kinds of records that are looked at."""

    FOOTER = 2
    SCHEMA = 3
    CHANNEL = 4
    MESSAGE = 5
    CHUNK = 6
    MESSAGE_INDEX = 7
    CHUNK_INDEX = 8
    STATISTICS = 11
    DATA_END = 15


class Record(NamedTuple):
    """A whole record: where it begins, its kind, where its content begins and ends."""

    at: int
    kind: int
    begin: int
    end: int


class Schema(NamedTuple):
    """The type of a channel's messages; `encoding` says in which language it is defined."""

    name: str
    encoding: str
    text: str


class Channel(NamedTuple):
    """A topic of one type and encoding."""

    topic: str
    schema: int
    encoding: str


class Message(NamedTuple):
    """A message; `log_time` in ns."""

    channel: int
    log_time: int
    data: bytes


@dataclass
class Definitions:
    """Schemas and channels by their numbers."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, kind: int, content: bytes) -> None:
        """Take the content of a record, if it is a schema or a channel."""
        if kind == Kind.SCHEMA:
            (number,) = struct.unpack_from("<H", content)
            name, at = _string(content, 2)
            encoding, at = _string(content, at)
            text, _ = _string(content, at)
            self.schemas[number] = Schema(name, encoding, text)
        elif kind == Kind.CHANNEL:
            number, schema = struct.unpack_from("<HH", content)
            topic, at = _string(content, 4)
            encoding, _ = _string(content, at)
            self.channels[number] = Channel(topic, schema, encoding)

    @property
    def is_complete(self) -> bool:
        """Whether there are channels, and the schemas that they name."""
        wanted = {c.schema for c in self.channels.values()} - {0}  # 0: without
        return bool(self.channels) and wanted <= self.schemas.keys()


class ChunkIndex(NamedTuple):
    """Where a chunk is, the log times in it (ns), and its messages by channel.

    `counts` is None where the chunk has no message index.
    """

    start_time: int
    end_time: int
    at: int
    length: int
    counts: dict[int, int] | None


def records(stream: Any, at: int, end: int) -> Iterator[Record]:
    """Yield every whole record of a stream between two places."""
    while at + _HEAD.size <= end:
        stream.seek(at)
        kind, length = _HEAD.unpack(stream.read(_HEAD.size))
        begin = at + _HEAD.size
        if begin + length > end:
            return
        yield Record(at, kind, begin, begin + length)
        at = begin + length


def records_of_chunk(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield kind and content of the records in the content of a chunk.

    Raises:
        ValueError, struct.error, rosbags.rosbag2.ReaderError: it is damaged.
    """
    _, _, size, checksum = _CHUNK.unpack_from(content)
    compression, at = _string(content, _CHUNK.size)
    (packed,) = struct.unpack_from("<Q", content, at)
    if at + 8 + packed > len(content):
        raise ValueError("a chunk that is longer than its record")
    data = decompress(content[at + 8 : at + 8 + packed], compression, size, checksum)
    at = 0
    while at < len(data):
        kind, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if at + length > len(data):
            raise ValueError("a record that is longer than its chunk")
        yield kind, data[at : at + length]
        at += length


def message(content: bytes) -> Message:
    """Read the content of a message's record."""
    channel, _, log_time, _ = _MESSAGE.unpack_from(content)
    return Message(channel, log_time, content[_MESSAGE.size :])


def message_head(content: bytes) -> tuple[int, int]:
    """Return a message's channel and log time in ns, from the beginning of its content."""
    channel, _, log_time, _ = _MESSAGE.unpack_from(content)
    return channel, log_time


def message_index_head(content: bytes) -> tuple[int, int]:
    """Return the channel of a message index and the number of messages, from its beginning."""
    channel, size = struct.unpack_from("<HI", content)
    return channel, size // _INDEX_ENTRY


def chunk_times(content: bytes) -> tuple[int, int]:
    """Return the first and last log time of a chunk, ns, from the beginning of its content."""
    start, end, _, _ = _CHUNK.unpack_from(content)
    return start, end


def chunk_index(content: bytes) -> ChunkIndex:
    """Read the content of a chunk index.

    How many messages a chunk has per channel follows from the lengths of its message indexes, which
    lie behind one another.
    """
    start, end, at, length, size = _CHUNK_INDEX.unpack_from(content)
    pairs = struct.iter_unpack("<HQ", content[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size])
    offsets = sorted((place, channel) for channel, place in pairs)
    if not offsets:
        return ChunkIndex(start, end, at, length, None)
    (indexed,) = struct.unpack_from("<Q", content, _CHUNK_INDEX.size + size)
    ends = [place for place, _ in offsets[1:]] + [at + length + indexed]
    counts = {
        channel: (end - place - _INDEX_HEAD) // _INDEX_ENTRY
        for (place, channel), end in zip(offsets, ends, strict=True)
    }
    return ChunkIndex(start, end, at, length, counts)


def statistics(content: bytes) -> tuple[int, int, dict[int, int]]:
    """Return the number of messages, of chunks, and of messages by channel."""
    count, _, _, _, _, chunks, _, _ = _STATISTICS.unpack_from(content)
    (size,) = struct.unpack_from("<I", content, _STATISTICS.size)
    pairs = content[_STATISTICS.size + 4 : _STATISTICS.size + 4 + size]
    return count, chunks, dict(struct.iter_unpack("<HQ", pairs))


def summary_start(stream: Any, size: int) -> int | None:
    """Return where the summary begins, 0 where the file has none; None for a file that is cut off.

    Raises:
        ValueError: the file ends as a whole one does, but its footer is damaged.
    """
    tail = _FOOTER.size + len(MAGIC)
    stream.seek(max(0, size - tail))
    footer = stream.read()
    if not footer.endswith(MAGIC) or size < 2 * len(MAGIC) + _FOOTER.size:
        return None
    kind, length, start, _, _ = _FOOTER.unpack_from(footer)
    if (kind, length) != (Kind.FOOTER, _FOOTER.size - _HEAD.size) or start > size - tail:
        raise ValueError("invalid footer")
    return int(start)


def _string(data: bytes, at: int) -> tuple[str, int]:
    """Read a string; return it and the place behind it."""
    (length,) = struct.unpack_from("<I", data, at)
    if at + 4 + length > len(data):
        raise ValueError("a text that is longer than its record")
    return data[at + 4 : at + 4 + length].decode(errors="replace"), at + 4 + length
