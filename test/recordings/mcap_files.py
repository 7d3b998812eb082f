"""MCAP files as recorders of all kinds leave them, written record by record."""

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

MAGIC = b"\x89MCAP0\r\n"


class Topic(NamedTuple):
    """A channel with its schema: (name, encoding, text), or None."""

    name: str
    schema: tuple[str, str, str] | None
    encoding: str


class McapLayout(NamedTuple):
    """What a recorder writes besides the messages.

    Attributes:
        profile: of the header.
        chunk: messages in a chunk; 0: outside of chunks.
        message_index, chunk_index, statistics: whether they are there.
        repeated: whether schemas and channels are repeated in the summary.
    """

    profile: str = "ros2"
    chunk: int = 5
    message_index: bool = True
    chunk_index: bool = True
    statistics: bool = True
    repeated: bool = True


_USUAL = McapLayout()


def write_mcap(
    path: Path,
    topics: Sequence[Topic],
    messages: Sequence[tuple[int, int, bytes]],
    layout: McapLayout = _USUAL,
) -> Path:
    """Write a file; a message is (index of its topic, log time in ns, data)."""
    definitions = b"".join(_definition(i + 1, topic) for i, topic in enumerate(topics))
    body = MAGIC + record(1, string(layout.profile) + string("test"))
    indexes = []
    if layout.chunk == 0:
        body += definitions + b"".join(_message(*m) for m in messages)
    for k in range(0, len(messages) if layout.chunk else 0, layout.chunk or 1):
        part = messages[k : k + layout.chunk]
        at = len(body)
        chunk, places = _chunk(definitions if k == 0 else b"", part)
        body += chunk
        offsets = {}
        for channel, entries in places.items() if layout.message_index else ():
            offsets[channel] = len(body)
            pairs = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            body += record(7, struct.pack("<HI", channel, len(pairs)) + pairs)
        times = [t for _, t, _ in part]
        span = struct.pack("<QQQQ", min(times), max(times), at, len(chunk))
        listed = b"".join(struct.pack("<HQ", *pair) for pair in offsets.items())
        behind = struct.pack("<Q", len(body) - at - len(chunk))
        sizes = struct.pack("<QQ", len(chunk), len(chunk))
        indexes.append(span + struct.pack("<I", len(listed)) + listed + behind + string("") + sizes)
    body += record(15, bytes(4))
    start = len(body)
    body += definitions if layout.repeated else b""
    body += b"".join(record(8, index) for index in indexes) if layout.chunk_index else b""
    body += _statistics(topics, messages, len(indexes)) if layout.statistics else b""
    footer = struct.pack("<QQI", start if len(body) > start else 0, 0, 0)
    path.write_bytes(body + record(2, footer) + MAGIC)
    return path


def record(kind: int, content: bytes) -> bytes:
    return struct.pack("<BQ", kind, len(content)) + content


def string(text: str) -> bytes:
    return struct.pack("<I", len(text.encode())) + text.encode()


def _definition(number: int, topic: Topic) -> bytes:
    schema = b""
    if topic.schema:
        schema = record(3, struct.pack("<H", number) + b"".join(map(string, topic.schema)))
    head = struct.pack("<HH", number, number if topic.schema else 0)
    content = head + string(topic.name) + string(topic.encoding) + struct.pack("<I", 0)
    return schema + record(4, content)


def _message(topic: int, time: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", topic + 1, 0, time, time) + data)


def _chunk(
    definitions: bytes, messages: Sequence[tuple[int, int, bytes]]
) -> tuple[bytes, dict[int, list[tuple[int, int]]]]:
    data = definitions
    places: dict[int, list[tuple[int, int]]] = {}
    for topic, time, content in messages:
        places.setdefault(topic + 1, []).append((time, len(data)))
        data += _message(topic, time, content)
    times = [t for _, t, _ in messages]
    head = struct.pack("<QQQI", min(times), max(times), len(data), zlib.crc32(data))
    return record(6, head + string("") + struct.pack("<Q", len(data)) + data), places


def _statistics(
    topics: Sequence[Topic], messages: Sequence[tuple[int, int, bytes]], chunks: int
) -> bytes:
    times = [t for _, t, _ in messages]
    counts = [sum(topic == i for topic, _, _ in messages) for i in range(len(topics))]
    listed = b"".join(struct.pack("<HQ", i + 1, n) for i, n in enumerate(counts) if n)
    number = len(topics)
    head = struct.pack(
        "<QHIIIIQQ", len(messages), number, number, 0, 0, chunks, min(times), max(times)
    )
    return record(11, head + struct.pack("<I", len(listed)) + listed)
