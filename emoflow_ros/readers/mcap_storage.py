"""MCAP files of any profile, with any index or none, with the interface of rosbags' storages.

rosbags' own reader wants the profile `ros2`, schemas of ROS 2 alone, message indexes and, without
an index, messages in order. Recorders leave each of these out.
"""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.typesys.msg import normalize_msgtype

from emoflow_ros.readers import mcap_records as mcap
from emoflow_ros.readers.mcap_records import Definitions, Kind

# By the encoding of a schema: how the type is defined, and how messages are serialised.
_OF_SCHEMA = {
    "ros1msg": (MessageDefinitionFormat.MSG, "ros1"),
    "ros2msg": (MessageDefinitionFormat.MSG, "cdr"),
    "ros2idl": (MessageDefinitionFormat.IDL, "cdr"),
    "omgidl": (MessageDefinitionFormat.IDL, "cdr"),
}
_BLOCK = 1 << 20  # bytes of messages outside of chunks that are read at once


@dataclass
class _Block:
    """A chunk, or messages outside of chunks behind one another: where, and their log times, ns."""

    at: int
    end: int
    start_time: int
    end_time: int
    counts: Counter[int] | None = None  # by channel; None where they are not known

    def add(self, channel: int, log_time: int) -> None:
        """Count a message."""
        if not self.counts:
            self.counts, self.start_time, self.end_time = Counter(), log_time, log_time
        self.start_time = min(log_time, self.start_time)
        self.end_time = max(log_time, self.end_time)
        self.counts[channel] += 1


@dataclass
class _Contents:
    """What a file holds. `counts` are messages by channel."""

    definitions: Definitions = field(default_factory=Definitions)
    blocks: list[_Block] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)


class McapStorage:
    """An MCAP file.

    Args:
        path: of the file.

    Attributes:
        connections: one for each channel.
        metadata: times of the first and last message, and their number.
        is_cut: whether the file ends before its end; it is read as far as it is whole.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.connections: list[Connection] = []
        self.metadata = _metadata([], 0)
        self.is_cut = False
        self._stream: Any = None
        self._blocks: list[_Block] = []

    def open(self) -> None:
        """Read the index, or find all messages.

        Raises:
            Exception: of any kind, from damaged data.
        """
        self._stream = self.path.open("rb")
        try:
            size = self.path.stat().st_size
            start = mcap.summary_start(self._stream, size)
            self.is_cut = start is None
            found = self._summary(start, size) if start else None
            if found is None:
                found = self._walk(size)
        except BaseException:
            self.close()
            raise
        self._blocks = found.blocks
        self.connections = [
            self._connection(number, found) for number in sorted(found.definitions.channels)
        ]
        self.metadata = _metadata(found.blocks, found.counts.total())

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def messages(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, log time and data in order of log time, from start to before stop, ns.

        Blocks that overlap in time are held in memory together, no others.
        """
        wanted = {c.id: c for c in connections}
        low, high = start or 0, 1 << 64 if stop is None else stop
        blocks = [
            block
            for block in self._blocks
            if block.start_time < high
            and block.end_time >= low
            and (block.counts is None or block.counts.keys() & wanted.keys())
        ]
        waiting: list[tuple[int, int, mcap.Message]] = []
        number = 0
        for block in sorted(blocks, key=lambda b: b.start_time):
            while waiting and waiting[0][0] < block.start_time:
                yield _popped(waiting, wanted)
            for message in self._read(block):
                if message.channel in wanted and low <= message.log_time < high:
                    heapq.heappush(waiting, (message.log_time, number, message))
                    number += 1  # messages of one time stay in the file's order
        while waiting:
            yield _popped(waiting, wanted)

    def _summary(self, start: int, size: int) -> _Contents | None:
        """Read the index; None where it does not tell all of what is needed."""
        found = _Contents()
        count = chunks = None
        for record in mcap.records(self._stream, start, size):
            if record.kind == Kind.FOOTER:
                break
            content = self._content(record)
            found.definitions.add(record.kind, content)
            if record.kind == Kind.CHUNK_INDEX:
                index = mcap.chunk_index(content)
                counts = None if index.counts is None else Counter(index.counts)
                end = index.at + index.length
                block = _Block(index.at, end, index.start_time, index.end_time, counts)
                found.blocks.append(block)
            elif record.kind == Kind.STATISTICS:
                count, chunks, by_channel = mcap.statistics(content)
                found.counts = Counter(by_channel)
        else:  # damaged
            return None
        indexed = all(block.counts is not None for block in found.blocks)
        if indexed and found.blocks:
            found.counts = sum((b.counts for b in found.blocks if b.counts), Counter())
        is_told = indexed or count is not None
        is_whole = count in (None, found.counts.total()) and chunks in (None, len(found.blocks))
        usable = found.blocks and found.definitions.is_complete and is_told and is_whole
        return found if usable else None

    def _walk(self, size: int) -> _Contents:
        """Look at every record up to the end of the data."""
        found = _Contents()
        loose: _Block | None = None
        end = len(mcap.MAGIC)
        for record in mcap.records(self._stream, end, size):
            end = record.end
            if record.kind in (Kind.DATA_END, Kind.FOOTER):
                break
            if record.kind == Kind.MESSAGE:
                if loose is None or loose.at + _BLOCK < record.end:
                    loose = _Block(record.at, record.end, 0, 0)
                    found.blocks.append(loose)
                loose.add(*mcap.message_head(self._content(record, mcap.MESSAGE_HEAD)))
                loose.end = record.end
                continue
            loose = None  # its messages lie behind one another
            if record.kind == Kind.CHUNK:
                self._complete(found)
                times = mcap.chunk_times(self._content(record, mcap.CHUNK_HEAD))
                found.blocks.append(_Block(record.at, record.end, *times))
            elif record.kind == Kind.MESSAGE_INDEX and found.blocks:
                channel, count = mcap.message_index_head(self._content(record, mcap.INDEX_HEAD))
                last = found.blocks[-1]
                last.counts = (last.counts or Counter()) + Counter({channel: count})
            elif record.kind in (Kind.SCHEMA, Kind.CHANNEL):
                found.definitions.add(record.kind, self._content(record))
        else:
            if not self.is_cut and end != size - len(mcap.MAGIC):
                raise ValueError(f"a record at byte {end} that is longer than the file")
            if found.blocks and loose is None:
                found.blocks[-1].counts = None  # some of its indexes may be cut off
        self._complete(found)
        found.counts = sum((b.counts for b in found.blocks if b.counts), Counter())
        if self.is_cut and not found.counts:
            raise ValueError("cut off before anything in it was whole")
        return found

    def _complete(self, found: _Contents) -> None:
        """Look into the last chunk, where no index tells its messages or it has new channels."""
        if not found.blocks:
            return
        block = found.blocks[-1]
        if block.counts is not None and block.counts.keys() <= found.definitions.channels.keys():
            return
        block.counts = Counter()
        for record in mcap.records(self._stream, block.at, block.end):
            for kind, content in self._inner(record):
                found.definitions.add(kind, content)
                if kind == Kind.MESSAGE:
                    block.add(*mcap.message_head(content))

    def _inner(self, record: mcap.Record) -> Iterator[tuple[int, bytes]]:
        """Yield kind and content of a record, or of those in a chunk."""
        content = self._content(record)
        if record.kind == Kind.CHUNK:
            yield from mcap.records_of_chunk(content)
        else:
            yield record.kind, content

    def _read(self, block: _Block) -> Iterator[mcap.Message]:
        for record in mcap.records(self._stream, block.at, block.end):
            for kind, content in self._inner(record):
                if kind == Kind.MESSAGE:
                    yield mcap.message(content)

    def _content(self, record: mcap.Record, most: int | None = None) -> bytes:
        """Read the content of a record, or its first bytes."""
        length = record.end - record.begin
        self._stream.seek(record.begin)
        return bytes(self._stream.read(length if most is None else min(most, length)))

    def _connection(self, number: int, found: _Contents) -> Connection:
        """Describe a channel; the encoding of its schema decides how it is read."""
        channel = found.definitions.channels[number]
        schema = found.definitions.schemas.get(channel.schema)
        name, text = (schema.name, schema.text) if schema else ("", "")
        encoding = schema.encoding if schema else ""
        form, serialization = _OF_SCHEMA.get(
            encoding, (MessageDefinitionFormat.NONE, channel.encoding)
        )
        if encoding in _OF_SCHEMA:
            name = normalize_msgtype(name)
        return Connection(
            number,
            channel.topic,
            name or f"no type, {channel.encoding or 'no encoding'}",
            MessageDefinition(form, text),
            "",
            found.counts[number],
            ConnectionExtRosbag2(serialization, []),
            self,
        )


def _metadata(blocks: list[_Block], count: int) -> ReaderMetadata:
    filled = [b for b in blocks if b.end_time]  # the times of an empty chunk are 0
    start = min((b.start_time for b in filled), default=(1 << 63) - 1)
    end = max((b.end_time + 1 for b in filled), default=0)
    return ReaderMetadata(max(0, end - start), start, end, count, None, None, None, None)


def _popped(
    waiting: list[tuple[int, int, mcap.Message]], wanted: dict[int, Connection]
) -> tuple[Connection, int, bytes]:
    log_time, _, message = heapq.heappop(waiting)
    return wanted[message.channel], log_time, message.data
