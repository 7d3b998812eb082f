"""Unfinished MCAP files: MCAP specification."""

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from emoflow_ros.offline.readers.unfinished_file import (
    Chunk,
    finished_file,
    number,
    records_of_new,
)

_MAGIC = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX, _DATA_END = (
    2, 3, 4, 5, 6, 7, 8, 15,
)  # fmt: skip
_CHUNK_HEAD = 32  # start, end, size, checksum and the length of the compression's name


def finish_mcap(file: Path, stream: Any) -> Path | None:
    """Make an unfinished MCAP file readable; None where it was finished or nothing is whole."""
    size = file.stat().st_size
    stream.seek(max(0, size - len(_MAGIC)))
    if stream.read() == _MAGIC:
        return None
    chunks: list[Chunk] = []
    definitions: list[bytes] = []
    whole = len(_MAGIC)
    has_messages = False
    for at, kind, data_at, length in _mcap_records(stream, whole, size):
        if kind == _DATA_END:
            break
        if kind == _CHUNK:
            chunks.append(_mcap_chunk(stream, at, length))
        elif kind == _MESSAGE_INDEX and chunks:
            (channel,) = struct.unpack("<H", stream.read(2))
            last = chunks[-1]
            last.index_at[channel] = at
            last.counts[channel] = (length - 6) // 16
            chunks[-1] = last._replace(end=data_at + length)
        elif kind in (_SCHEMA, _CHANNEL):
            stream.seek(at)
            definitions.append(stream.read(9 + length))
        has_messages |= kind in (_MESSAGE, _CHUNK)
        whole = data_at + length
    if not has_messages:
        return None
    if not any(chunk.counts for chunk in chunks):  # without indexes: it is read from its start
        return finished_file(file, whole, {}, _mcap_end(0))
    chunks = [chunk for chunk in chunks if chunk.counts]
    whole = chunks[-1].end
    inner = records_of_new(stream, chunks, _decompress, _mcap_definitions)
    summary = b"".join([*definitions, *inner.values(), *map(_chunk_index, chunks)])
    return finished_file(file, whole, {}, summary + _mcap_end(whole))


def _mcap_records(stream: Any, at: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield start, kind, start of the content and its length of every whole record."""
    while at + 9 <= end:
        stream.seek(at)
        kind, length = struct.unpack("<BQ", stream.read(9))
        if at + 9 + length > end:
            return
        yield at, kind, at + 9, length
        at += 9 + length


def _mcap_chunk(stream: Any, at: int, length: int) -> Chunk:
    start, end, size, _, name_length = struct.unpack("<QQQII", stream.read(_CHUNK_HEAD))
    if _CHUNK_HEAD + name_length + 8 > length:
        raise ValueError("a chunk that is shorter than its head")
    name = stream.read(name_length)
    (packed,) = struct.unpack("<Q", stream.read(8))
    data_at = at + 9 + _CHUNK_HEAD + name_length + 8
    if data_at + packed > at + 9 + length:
        raise ValueError("a chunk that is longer than its record")
    return Chunk(at, at + 9 + length, start, end, {}, {}, name, (data_at, packed), size)


def _mcap_definitions(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield every channel with its schema before it, by the channel's number."""
    schemas: dict[int, bytes] = {}
    for at, kind, data_at, length in _mcap_records(io.BytesIO(data), 0, len(data)):
        record = data[at : data_at + length]
        if kind == _SCHEMA:
            schemas[number(data[data_at : data_at + 2])] = record
        elif kind == _CHANNEL:
            channel, schema = struct.unpack_from("<HH", data, data_at)
            yield channel, schemas.get(schema, b"") + record


def _chunk_index(chunk: Chunk) -> bytes:
    offsets = b"".join(struct.pack("<HQ", *pair) for pair in chunk.index_at.items())
    indexed = min(chunk.index_at.values())
    content = struct.pack("<QQQQ", chunk.start_time, chunk.end_time, chunk.at, indexed - chunk.at)
    content += struct.pack("<I", len(offsets)) + offsets + struct.pack("<Q", chunk.end - indexed)
    content += struct.pack("<I", len(chunk.name)) + chunk.name
    content += struct.pack("<QQ", chunk.data[1], chunk.size)
    return struct.pack("<BQ", _CHUNK_INDEX, len(content)) + content


def _mcap_end(summary: int) -> bytes:
    return struct.pack("<BQQQI", _FOOTER, 20, summary, 0, 0) + _MAGIC


def _decompress(chunk: Chunk, packed: bytes) -> bytes:
    return DECOMPRESSORS[chunk.name.decode()](packed, chunk.size)
