"""Bags whose recorder was stopped before it wrote the index: read as if it had just written it.

The whole records are found by walking over them. An index of them is appended in memory; the file
itself stays as it is. Sources: ROS bag format 2.0, MCAP specification.
"""

import io
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from shutil import copyfile
from typing import Any

from rosbags.rosbag1.reader import decompressors
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

from emoflow_ros.readers.appended_index import BagChunk, finished_file, number, records_of_new

_ROS1_START = 13  # after the line with the version
_ROS1_HEAD_FIELDS = (b"index_pos=", b"conn_count=", b"chunk_count=")
_ROS1_INDEX, _ROS1_CHUNK, _ROS1_CHUNK_INFO, _ROS1_CONNECTION = 4, 5, 6, 7

_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MCAP_FOOTER, _MCAP_SCHEMA, _MCAP_CHANNEL, _MCAP_MESSAGE, _MCAP_CHUNK = 2, 3, 4, 5, 6
_MCAP_MESSAGE_INDEX, _MCAP_CHUNK_INDEX, _MCAP_DATA_END = 7, 8, 15
_MCAP_CHUNK_HEAD = 32  # start, end, size, checksum and the length of the compression's name


def _finish_ros1(file: Path, stream: Any) -> Path | None:
    """Make an unfinished ROS 1 bag readable; None where it was finished or nothing is whole."""
    size = file.stat().st_size
    head = stream.read(8192)
    places = {name: head.index(name) + len(name) for name in _ROS1_HEAD_FIELDS}
    index_pos = int.from_bytes(head[places[b"index_pos="] :][:8], "little")
    if 0 < index_pos < size:
        return None
    chunks: list[BagChunk] = []
    for at, fields, data_at, length in _ros1_records(stream, _ROS1_START, size):
        kind = fields[b"op"][0]
        if kind in (_ROS1_CONNECTION, _ROS1_CHUNK_INFO):
            break
        if kind == _ROS1_CHUNK:
            packing = fields[b"compression"], (data_at, length), number(fields[b"size"])
            chunks.append(BagChunk(at, data_at + length, -1, -1, {}, {}, *packing))
        if kind == _ROS1_INDEX and chunks:
            chunks[-1] = _with_ros1_index(chunks[-1], fields, stream.read(length), data_at + length)
    chunks = [chunk for chunk in chunks if chunk.counts]
    if not chunks:
        return None
    connections = records_of_new(stream, chunks, _ros1_decompressed, _ros1_connections)
    tail = b"".join(connections.values()) + b"".join(map(_ros1_chunk_info, chunks))
    whole = chunks[-1].end
    values = ((whole, 8), (len(connections), 4), (len(chunks), 4))
    patches = {
        place: value.to_bytes(bytes_, "little")
        for place, (value, bytes_) in zip(places.values(), values, strict=True)
    }
    return finished_file(file, whole, patches, tail)


def _ros1_records(
    stream: Any, at: int, end: int
) -> Iterator[tuple[int, dict[bytes, bytes], int, int]]:
    """Yield start, header, start of the data and its length of every whole record."""
    while at + 8 <= end:
        stream.seek(at)
        length = number(stream.read(4))
        if at + 8 + length > end:
            return
        header = stream.read(length)
        data = number(stream.read(4))
        data_at = at + 8 + length
        if data_at + data > end:
            return
        yield at, _ros1_fields(header), data_at, data
        at = data_at + data


def _ros1_fields(header: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(header):
        length = number(header[at : at + 4])
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields


def _with_ros1_index(
    chunk: BagChunk, fields: dict[bytes, bytes], data: bytes, end: int
) -> BagChunk:
    count = number(fields[b"count"])
    times = [s * 10**9 + ns for s, ns, _ in struct.iter_unpack("<III", data[: 12 * count])]
    known = [chunk.start_time, chunk.end_time] if chunk.counts else []
    counts = chunk.counts | {number(fields[b"conn"]): count}
    low, high = min(times + known), max(times + known)
    return chunk._replace(end=end, start_time=low, end_time=high, counts=counts)


def _ros1_connections(data: bytes) -> Iterator[tuple[int, bytes]]:
    for at, fields, data_at, length in _ros1_records(io.BytesIO(data), 0, len(data)):
        if fields[b"op"][0] == _ROS1_CONNECTION:
            yield number(fields[b"conn"]), data[at : data_at + length]


def _ros1_chunk_info(chunk: BagChunk) -> bytes:
    times = [struct.pack("<II", *divmod(t, 10**9)) for t in (chunk.start_time, chunk.end_time)]
    fields = {
        b"op": bytes([_ROS1_CHUNK_INFO]),
        b"ver": struct.pack("<I", 1),
        b"chunk_pos": struct.pack("<Q", chunk.at),
        b"start_time": times[0],
        b"end_time": times[1],
        b"count": struct.pack("<I", len(chunk.counts)),
    }
    parts = [name + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    data = b"".join(struct.pack("<II", *pair) for pair in chunk.counts.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _ros1_decompressed(chunk: BagChunk, packed: bytes) -> bytes:
    return decompressors[chunk.name.decode()](packed)


def _finish_mcap(file: Path, stream: Any) -> Path | None:
    """Make an unfinished MCAP file readable; None where it was finished or nothing is whole."""
    size = file.stat().st_size
    stream.seek(max(0, size - len(_MCAP_MAGIC)))
    if stream.read() == _MCAP_MAGIC:
        return None
    chunks: list[BagChunk] = []
    definitions: list[bytes] = []
    whole = len(_MCAP_MAGIC)
    has_messages = False
    for at, kind, data_at, length in _mcap_records(stream, whole, size):
        if kind == _MCAP_DATA_END:
            break
        if kind == _MCAP_CHUNK:
            chunks.append(_mcap_chunk(stream, at, length))
        elif kind == _MCAP_MESSAGE_INDEX and chunks:
            (channel,) = struct.unpack("<H", stream.read(2))
            last = chunks[-1]
            last.index_at[channel] = at
            last.counts[channel] = (length - 6) // 16
            chunks[-1] = last._replace(end=data_at + length)
        elif kind in (_MCAP_SCHEMA, _MCAP_CHANNEL):
            stream.seek(at)
            definitions.append(stream.read(9 + length))
        has_messages |= kind in (_MCAP_MESSAGE, _MCAP_CHUNK)
        whole = data_at + length
    if not has_messages:
        return None
    if not any(chunk.counts for chunk in chunks):  # without indexes: it is read from its start
        return finished_file(file, whole, {}, _mcap_end(0))
    chunks = [chunk for chunk in chunks if chunk.counts]
    whole = chunks[-1].end
    inner = records_of_new(stream, chunks, _mcap_decompressed, _mcap_definitions)
    summary = b"".join([*definitions, *inner.values(), *map(_mcap_chunk_index, chunks)])
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


def _mcap_chunk(stream: Any, at: int, length: int) -> BagChunk:
    start, end, size, _, name_length = struct.unpack("<QQQII", stream.read(_MCAP_CHUNK_HEAD))
    if _MCAP_CHUNK_HEAD + name_length + 8 > length:
        raise ValueError("a chunk that is shorter than its head")
    name = stream.read(name_length)
    (packed,) = struct.unpack("<Q", stream.read(8))
    data_at = at + 9 + _MCAP_CHUNK_HEAD + name_length + 8
    if data_at + packed > at + 9 + length:
        raise ValueError("a chunk that is longer than its record")
    return BagChunk(at, at + 9 + length, start, end, {}, {}, name, (data_at, packed), size)


def _mcap_definitions(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield every channel with its schema before it, by the channel's number."""
    schemas: dict[int, bytes] = {}
    for at, kind, data_at, length in _mcap_records(io.BytesIO(data), 0, len(data)):
        record = data[at : data_at + length]
        if kind == _MCAP_SCHEMA:
            schemas[number(data[data_at : data_at + 2])] = record
        elif kind == _MCAP_CHANNEL:
            channel, schema = struct.unpack_from("<HH", data, data_at)
            yield channel, schemas.get(schema, b"") + record


def _mcap_chunk_index(chunk: BagChunk) -> bytes:
    offsets = b"".join(struct.pack("<HQ", *pair) for pair in chunk.index_at.items())
    indexed = min(chunk.index_at.values())
    content = struct.pack("<QQQQ", chunk.start_time, chunk.end_time, chunk.at, indexed - chunk.at)
    content += struct.pack("<I", len(offsets)) + offsets + struct.pack("<Q", chunk.end - indexed)
    content += struct.pack("<I", len(chunk.name)) + chunk.name
    content += struct.pack("<QQ", chunk.data[1], chunk.size)
    return struct.pack("<BQ", _MCAP_CHUNK_INDEX, len(content)) + content


def _mcap_end(summary: int) -> bytes:
    return struct.pack("<BQQQI", _MCAP_FOOTER, 20, summary, 0, 0) + _MCAP_MAGIC


def _mcap_decompressed(chunk: BagChunk, packed: bytes) -> bytes:
    return DECOMPRESSORS[chunk.name.decode()](packed, chunk.size)


_JOURNALS = ("-wal", "-journal")

_FINISH = {".bag": _finish_ros1, ".mcap": _finish_mcap}


def finished(file: Path, folder: Path) -> Path | None:
    """Make an unfinished storage file readable.

    Args:
        file: a .bag, .mcap or .db3 file.
        folder: for the copy of a database, which its journal is worked into.

    Returns:
        What to read in its place; None where it was finished or holds nothing that is whole.
    """
    if file.suffix == ".db3":
        return _finished_database(file, folder)
    finish = _FINISH.get(file.suffix)
    if finish is None or not file.is_file():
        return None
    try:
        with file.open("rb") as stream:
            return finish(file, stream)
    except Exception:  # damaged in other ways, as any of the libraries may say
        return None


def _finished_database(file: Path, folder: Path) -> Path | None:
    journals = [Path(f"{file}{suffix}") for suffix in _JOURNALS]
    there = [j for j in journals if j.is_file() and j.stat().st_size]
    if not there:
        return None
    for source in (file, *there):
        copyfile(source, folder / source.name)
    try:
        database = sqlite3.connect(folder / file.name)
        database.execute("PRAGMA journal_mode=DELETE").fetchall()
        database.close()
    except sqlite3.Error:
        return None
    return folder / file.name
