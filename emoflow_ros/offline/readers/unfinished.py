"""Bags whose recorder was stopped before it wrote the index: read as if it had just done so.

What is whole is found by walking over the records, and an index of it is put behind them, in
memory: the file itself stays as it is. Layouts: ROS bag format 2.0; MCAP specification.
"""

import io
import sqlite3
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from shutil import copyfile
from typing import Any, NamedTuple

from rosbags.rosbag1.reader import decompressors
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

_JOURNALS = ("-wal", "-journal")
_ROS1_START = 13  # after the line with the version
_HEAD_FIELDS = (b"index_pos=", b"conn_count=", b"chunk_count=")
_INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 4, 5, 6, 7
_MCAP = b"\x89MCAP0\r\n"
_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _MCAP_CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX, _DATA_END = (
    2, 3, 4, 5, 6, 7, 8, 15,
)  # fmt: skip
_CHUNK_HEAD = 32  # start, end, size, checksum and the length of the compression's name


class FinishedFile(type(Path())):  # type: ignore[misc]
    """A path that opens as the first `whole` bytes of its file, patched, and a `tail`."""

    whole: int
    patches: dict[int, bytes]
    tail: bytes

    def open(self, *args: Any, **kwargs: Any) -> Any:
        """Open for reading bytes."""
        return io.BufferedReader(_Finished(self))


class _Finished(io.RawIOBase):
    def __init__(self, path: FinishedFile) -> None:
        self._file = io.FileIO(str(path))
        self._path = path
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        end = self._path.whole + len(self._path.tail)
        self._at = max(0, offset + (0, self._at, end)[whence])
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        path, at = self._path, self._at
        data: bytes | bytearray
        if at >= path.whole:
            data = path.tail[at - path.whole : at - path.whole + len(buffer)]
        else:
            self._file.seek(at)
            data = bytearray(self._file.read(min(len(buffer), path.whole - at)))
            for start, patch in path.patches.items():
                low, high = max(at, start), min(at + len(data), start + len(patch))
                if low < high:
                    data[low - at : high - at] = patch[low - start : high - start]
        buffer[: len(data)] = data
        self._at += len(data)
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()


class _Chunk(NamedTuple):
    """A chunk, and per connection or channel where its index is and how many messages it has."""

    at: int
    end: int
    start_time: int
    end_time: int
    counts: dict[int, int]
    index_at: dict[int, int]
    name: bytes  # of the compression
    data: tuple[int, int]  # where it begins, bytes
    size: int  # uncompressed


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
    finish = {".bag": _finish_ros1, ".mcap": _finish_mcap}.get(file.suffix)
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


def _finish_ros1(file: Path, stream: Any) -> Path | None:
    size = file.stat().st_size
    head = stream.read(8192)
    places = {name: head.index(name) + len(name) for name in _HEAD_FIELDS}
    index_pos = int.from_bytes(head[places[b"index_pos="] :][:8], "little")
    if 0 < index_pos < size:
        return None
    chunks: list[_Chunk] = []
    for at, fields, data_at, length in _ros1_records(stream, _ROS1_START, size):
        kind = fields[b"op"][0]
        if kind in (_CONNECTION, _CHUNK_INFO):
            break
        if kind == _CHUNK:
            packing = fields[b"compression"], (data_at, length), _number(fields[b"size"])
            chunks.append(_Chunk(at, data_at + length, -1, -1, {}, {}, *packing))
        if kind == _INDEX and chunks:
            chunks[-1] = _with_index(chunks[-1], fields, stream.read(length), data_at + length)
    chunks = [chunk for chunk in chunks if chunk.counts]
    if not chunks:
        return None
    connections = _records_of_new(stream, chunks, decompressors, _ros1_connections)
    tail = b"".join(connections.values()) + b"".join(map(_chunk_info, chunks))
    whole = chunks[-1].end
    values = ((whole, 8), (len(connections), 4), (len(chunks), 4))
    patches = {
        place: value.to_bytes(bytes_, "little")
        for place, (value, bytes_) in zip(places.values(), values, strict=True)
    }
    return _make(file, whole, patches, tail)


def _ros1_records(
    stream: Any, at: int, end: int
) -> Iterator[tuple[int, dict[bytes, bytes], int, int]]:
    """Yield start, header, start of the data and its length of every whole record."""
    while at + 8 <= end:
        stream.seek(at)
        length = _number(stream.read(4))
        if at + 8 + length > end:
            return
        header = stream.read(length)
        data = _number(stream.read(4))
        data_at = at + 8 + length
        if data_at + data > end:
            return
        yield at, _fields(header), data_at, data
        at = data_at + data


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, at = {}, 0
    while at < len(header):
        length = _number(header[at : at + 4])
        name, _, value = header[at + 4 : at + 4 + length].partition(b"=")
        fields[name] = value
        at += 4 + length
    return fields


def _with_index(chunk: _Chunk, fields: dict[bytes, bytes], data: bytes, end: int) -> _Chunk:
    count = _number(fields[b"count"])
    times = [s * 10**9 + ns for s, ns, _ in struct.iter_unpack("<III", data[: 12 * count])]
    known = [chunk.start_time, chunk.end_time] if chunk.counts else []
    counts = chunk.counts | {_number(fields[b"conn"]): count}
    low, high = min(times + known), max(times + known)
    return chunk._replace(end=end, start_time=low, end_time=high, counts=counts)


def _ros1_connections(data: bytes) -> Iterator[tuple[int, bytes]]:
    for at, fields, data_at, length in _ros1_records(io.BytesIO(data), 0, len(data)):
        if fields[b"op"][0] == _CONNECTION:
            yield _number(fields[b"conn"]), data[at : data_at + length]


def _chunk_info(chunk: _Chunk) -> bytes:
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


def _records_of_new(
    stream: Any,
    chunks: list[_Chunk],
    decompress: dict[Any, Any],
    records: Callable[[bytes], Iterator[tuple[int, bytes]]],
) -> dict[int, bytes]:
    """Collect the definitions of connections or channels, each from the first chunk with it."""
    found: dict[int, bytes] = {}
    for chunk in chunks:
        if chunk.counts.keys() <= found.keys():
            continue
        stream.seek(chunk.data[0])
        packed = stream.read(chunk.data[1])
        unpack = decompress[chunk.name.decode()]
        arguments = (packed, chunk.size) if decompress is DECOMPRESSORS else (packed,)
        found = dict(records(unpack(*arguments))) | found
    return found


def _finish_mcap(file: Path, stream: Any) -> Path | None:
    size = file.stat().st_size
    stream.seek(max(0, size - len(_MCAP)))
    if stream.read() == _MCAP:
        return None
    chunks: list[_Chunk] = []
    definitions: list[bytes] = []
    whole = len(_MCAP)
    has_messages = False
    for at, kind, data_at, length in _mcap_records(stream, whole, size):
        if kind == _DATA_END:
            break
        if kind == _MCAP_CHUNK:
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
        has_messages |= kind in (_MESSAGE, _MCAP_CHUNK)
        whole = data_at + length
    if not has_messages:
        return None
    if not any(chunk.counts for chunk in chunks):  # without indexes: it is read from its start
        return _make(file, whole, {}, _mcap_end(0))
    chunks = [chunk for chunk in chunks if chunk.counts]
    whole = chunks[-1].end
    inner = _records_of_new(stream, chunks, DECOMPRESSORS, _mcap_definitions)
    summary = b"".join([*definitions, *inner.values(), *map(_chunk_index, chunks)])
    return _make(file, whole, {}, summary + _mcap_end(whole))


def _mcap_records(stream: Any, at: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Yield start, kind, start of the content and its length of every whole record."""
    while at + 9 <= end:
        stream.seek(at)
        kind, length = struct.unpack("<BQ", stream.read(9))
        if at + 9 + length > end:
            return
        yield at, kind, at + 9, length
        at += 9 + length


def _mcap_chunk(stream: Any, at: int, length: int) -> _Chunk:
    start, end, size, _, name_length = struct.unpack("<QQQII", stream.read(_CHUNK_HEAD))
    if _CHUNK_HEAD + name_length + 8 > length:
        raise ValueError("a chunk that is shorter than its head")
    name = stream.read(name_length)
    (packed,) = struct.unpack("<Q", stream.read(8))
    data_at = at + 9 + _CHUNK_HEAD + name_length + 8
    if data_at + packed > at + 9 + length:
        raise ValueError("a chunk that is longer than its record")
    return _Chunk(at, at + 9 + length, start, end, {}, {}, name, (data_at, packed), size)


def _mcap_definitions(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield every channel with its schema before it, by the channel's number."""
    schemas: dict[int, bytes] = {}
    for at, kind, data_at, length in _mcap_records(io.BytesIO(data), 0, len(data)):
        record = data[at : data_at + length]
        if kind == _SCHEMA:
            schemas[_number(data[data_at : data_at + 2])] = record
        elif kind == _CHANNEL:
            channel, schema = struct.unpack_from("<HH", data, data_at)
            yield channel, schemas.get(schema, b"") + record


def _chunk_index(chunk: _Chunk) -> bytes:
    offsets = b"".join(struct.pack("<HQ", *pair) for pair in chunk.index_at.items())
    indexed = min(chunk.index_at.values())
    content = struct.pack("<QQQQ", chunk.start_time, chunk.end_time, chunk.at, indexed - chunk.at)
    content += struct.pack("<I", len(offsets)) + offsets + struct.pack("<Q", chunk.end - indexed)
    content += struct.pack("<I", len(chunk.name)) + chunk.name
    content += struct.pack("<QQ", chunk.data[1], chunk.size)
    return struct.pack("<BQ", _CHUNK_INDEX, len(content)) + content


def _mcap_end(summary: int) -> bytes:
    return struct.pack("<BQQQI", _FOOTER, 20, summary, 0, 0) + _MCAP


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _make(file: Path, whole: int, patches: dict[int, bytes], tail: bytes) -> FinishedFile:
    path = FinishedFile(file)
    path.whole, path.patches, path.tail = whole, patches, tail
    return path
