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
from typing import Any

from rosbags.rosbag1.reader import decompressors

from emoflow_ros.readers.appended_index import BagChunk, finished_file, number

_ROS1_START = 13  # after the line with the version
_ROS1_HEAD_FIELDS = (b"index_pos=", b"conn_count=", b"chunk_count=")
_JOURNALS = ("-wal", "-journal")
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
    for at, fields, data_at, length in _ros1_records(stream, _ROS1_START, size):
        kind = fields[b"op"][0]
        if kind in (_ROS1_CONNECTION, _ROS1_CHUNK_INFO):
            break
        if kind == _ROS1_CHUNK:
            packing = fields[b"compression"], (data_at, length), number(fields[b"size"])
            chunks.append(BagChunk(at, data_at + length, -1, -1, {}, *packing))
        if kind == _ROS1_INDEX and chunks:
            chunks[-1] = _with_ros1_index(chunks[-1], fields, stream.read(length), data_at + length)
    chunks = [chunk for chunk in chunks if chunk.counts]
    if not chunks:
        return None
    connections = _connections_of(stream, chunks)
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
    parts = [name + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    data = b"".join(struct.pack("<II", *pair) for pair in chunk.counts.items())
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
