"""Unfinished ROS 1 bags: ROS bag format 2.0."""

import io
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.rosbag1.reader import decompressors

from emoflow_ros.offline.readers.unfinished_file import (
    Chunk,
    finished_file,
    number,
    records_of_new,
)

_START = 13  # after the line with the version
_HEAD_FIELDS = (b"index_pos=", b"conn_count=", b"chunk_count=")
_INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 4, 5, 6, 7


def finish_ros1(file: Path, stream: Any) -> Path | None:
    """Make an unfinished ROS 1 bag readable; None where it was finished or nothing is whole."""
    size = file.stat().st_size
    head = stream.read(8192)
    places = {name: head.index(name) + len(name) for name in _HEAD_FIELDS}
    index_pos = int.from_bytes(head[places[b"index_pos="] :][:8], "little")
    if 0 < index_pos < size:
        return None
    chunks: list[Chunk] = []
    for at, fields, data_at, length in _ros1_records(stream, _START, size):
        kind = fields[b"op"][0]
        if kind in (_CONNECTION, _CHUNK_INFO):
            break
        if kind == _CHUNK:
            packing = fields[b"compression"], (data_at, length), number(fields[b"size"])
            chunks.append(Chunk(at, data_at + length, -1, -1, {}, {}, *packing))
        if kind == _INDEX and chunks:
            chunks[-1] = _with_index(chunks[-1], fields, stream.read(length), data_at + length)
    chunks = [chunk for chunk in chunks if chunk.counts]
    if not chunks:
        return None
    connections = records_of_new(stream, chunks, _decompress, _ros1_connections)
    tail = b"".join(connections.values()) + b"".join(map(_chunk_info, chunks))
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
        yield at, _fields(header), data_at, data
        at = data_at + data


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(header):
        length = number(header[at : at + 4])
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields


def _with_index(chunk: Chunk, fields: dict[bytes, bytes], data: bytes, end: int) -> Chunk:
    count = number(fields[b"count"])
    times = [s * 10**9 + ns for s, ns, _ in struct.iter_unpack("<III", data[: 12 * count])]
    known = [chunk.start_time, chunk.end_time] if chunk.counts else []
    counts = chunk.counts | {number(fields[b"conn"]): count}
    low, high = min(times + known), max(times + known)
    return chunk._replace(end=end, start_time=low, end_time=high, counts=counts)


def _ros1_connections(data: bytes) -> Iterator[tuple[int, bytes]]:
    for at, fields, data_at, length in _ros1_records(io.BytesIO(data), 0, len(data)):
        if fields[b"op"][0] == _CONNECTION:
            yield number(fields[b"conn"]), data[at : data_at + length]


def _chunk_info(chunk: Chunk) -> bytes:
    times = [struct.pack("<II", *divmod(t, 10**9)) for t in (chunk.start_time, chunk.end_time)]
    fields = {
        b"op": bytes([_CHUNK_INFO]),
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


def _decompress(chunk: Chunk, packed: bytes) -> bytes:
    return decompressors[chunk.name.decode()](packed)
