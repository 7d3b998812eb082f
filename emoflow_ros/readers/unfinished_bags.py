"""Bags whose recorder was stopped before it wrote the index: read as if it had just written it.

The whole records are found by walking over them. An index of them is appended in memory; the file
itself stays as it is. Source: ROS bag format 2.0. A database's journal is worked into a copy of it.
"""

import io
import sqlite3
import struct
from collections.abc import Iterator
from pathlib import Path
from shutil import copyfile
from typing import Any, NamedTuple

from rosbags.rosbag1.reader import decompressors

from emoflow_ros.readers.appended_index import BagChunk, finished_file, number

_ROS1_START = 13  # after the line with the version
_ROS1_HEAD_FIELDS = (b"index_pos=", b"conn_count=", b"chunk_count=")
_JOURNALS = ("-wal", "-journal")
_ROS1_MESSAGE = 2
_ROS1_INDEX, _ROS1_CHUNK, _ROS1_CHUNK_INFO, _ROS1_CONNECTION = 4, 5, 6, 7


def finished_ros1(file: Path) -> Path | None:
    """Return an unfinished ROS 1 bag with an index; None where it has one or nothing is whole."""
    try:
        with file.open("rb") as stream:
            return _finish_ros1(file, stream)
    except Exception:  # damaged in other ways, as any of the libraries may say
        return None


def _finish_ros1(file: Path, stream: Any) -> Path | None:
    size = file.stat().st_size
    head = stream.read(8192)
    places = {name: head.index(name) + len(name) for name in _ROS1_HEAD_FIELDS}
    index_pos = int.from_bytes(head[places[b"index_pos="] :][:8], "little")
    if 0 < index_pos < size:
        return None
    chunks: list[BagChunk] = []
    end = _ROS1_START
    for at, fields, data_at, length in _ros1_records(stream, _ROS1_START, size):
        kind = fields[b"op"][0]
        if kind in (_ROS1_CONNECTION, _ROS1_CHUNK_INFO):
            break
        if kind == _ROS1_CHUNK:
            packing = fields[b"compression"], (data_at, length), number(fields[b"size"])
            chunks.append(BagChunk(at, data_at + length, -1, -1, {}, *packing))
        if kind == _ROS1_INDEX and chunks:
            chunks[-1] = _with_ros1_index(chunks[-1], fields, stream.read(length), data_at + length)
        end = data_at + length
    begun = _begun_chunk(stream, chunks[-1].at if chunks and not chunks[-1].counts else end, size)
    chunks = [chunk for chunk in chunks if chunk.counts] + ([begun.chunk] if begun else [])
    if not chunks:
        return None
    connections = _connections_of(stream, chunks)
    index = begun.records if begun else b""
    tail = index + b"".join(connections.values()) + b"".join(map(_ros1_chunk_info, chunks))
    whole = chunks[-1].end
    values = ((whole + len(index), 8), (len(connections), 4), (len(chunks), 4))
    patches = {
        place: value.to_bytes(bytes_, "little")
        for place, (value, bytes_) in zip(places.values(), values, strict=True)
    }
    return finished_file(file, whole, patches | (begun.patches if begun else {}), tail)


class _Begun(NamedTuple):
    """A chunk whose recorder had not filled in its length, or written its index."""

    chunk: BagChunk
    patches: dict[int, bytes]
    records: bytes  # of its index


def _begun_chunk(stream: Any, at: int, size: int) -> _Begun | None:
    """Find the whole messages of an uncompressed chunk that was being written at the end.

    Its length is 0 until it is full: its messages then seem to be records beside it.
    """
    stream.seek(at)
    length = number(stream.read(4))
    header = stream.read(length)
    data_at = at + 8 + length
    fields = _ros1_fields(header) if data_at < size else {}
    if fields.get(b"op") != bytes([_ROS1_CHUNK]) or fields[b"compression"] != b"none":
        return None
    entries: dict[int, list[tuple[bytes, int]]] = {}
    end = data_at
    for start, inner, inner_at, inner_length in _ros1_records(stream, data_at, size):
        kind = inner[b"op"][0]
        if kind == _ROS1_MESSAGE:
            entry = inner[b"time"], start - data_at
            entries.setdefault(number(inner[b"conn"]), []).append(entry)
        elif kind != _ROS1_CONNECTION:
            break
        end = inner_at + inner_length
    if not entries:
        return None
    whole = end - data_at
    chunk = BagChunk(at, end, -1, -1, {}, b"none", (data_at, whole), whole)
    index = b""
    for connection, own in entries.items():
        data = b"".join(time + struct.pack("<I", offset) for time, offset in own)
        head = {b"op": bytes([_ROS1_INDEX]), b"ver": struct.pack("<I", 1)}
        head |= {b"conn": struct.pack("<I", connection), b"count": struct.pack("<I", len(own))}
        index += _ros1_record(head, data)
        chunk = _with_ros1_index(chunk, head, data, end)
    lengths = struct.pack("<I", whole)
    places = at + 4 + header.index(b"size=") + len(b"size="), data_at - 4
    return _Begun(chunk, dict.fromkeys(places, lengths), index)


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


def _connections_of(stream: Any, chunks: list[BagChunk]) -> dict[int, bytes]:
    """Collect the records of connections, each from the first chunk that has it."""
    found: dict[int, bytes] = {}
    for chunk in chunks:
        if chunk.counts.keys() <= found.keys():
            continue
        at, length = chunk.data
        stream.seek(at)
        data = decompressors[chunk.name.decode()](stream.read(length))
        found = dict(_ros1_connections(data)) | found
    return found


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
    return _ros1_record(fields, b"".join(struct.pack("<II", *p) for p in chunk.counts.items()))


def _ros1_record(fields: dict[bytes, bytes], data: bytes) -> bytes:
    parts = [name + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def finished_database(file: Path, folder: Path) -> Path | None:
    """Work the journal of a database's last process into a copy; None where it left none."""
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
