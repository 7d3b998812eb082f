"""A bag's file with an index appended to it in memory, and the chunks that the index lists."""

import io
from pathlib import Path
from typing import Any, NamedTuple


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


class BagChunk(NamedTuple):
    """A chunk; `counts` are its messages by connection."""

    at: int
    end: int
    start_time: int
    end_time: int
    counts: dict[int, int]
    name: bytes  # of the compression
    data: tuple[int, int]  # where it begins, bytes
    size: int  # uncompressed


def number(data: bytes) -> int:
    """Read an unsigned little-endian number."""
    return int.from_bytes(data, "little")


def finished_file(file: Path, whole: int, patches: dict[int, bytes], tail: bytes) -> FinishedFile:
    """Make the path of a file that ends after `whole` bytes, patched, and a tail."""
    path = FinishedFile(file)
    path.whole, path.patches, path.tail = whole, patches, tail
    return path
