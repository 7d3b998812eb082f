"""Reader of Prophesee RAW files with EVT 2.0, 2.1 or 3.0 words.

Source: https://docs.prophesee.ai/stable/data/file_formats/raw.html. Header lines start with
`% `, up to `% end` or the first line that does not; little-endian words follow.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.reader_base import FileRecording
from msg_adapters import Statistics, make_packet_decoder

_CHUNK_BYTES = 1 << 20
_MAX_HEADER_LINES = 1000
_ENCODINGS = {"EVT2": "evt2", "EVT21": "evt21", "EVT3": "evt3"}
_VERSIONS = {"2.0": "EVT2", "2.1": "EVT21", "3.0": "EVT3"}


class PropheseeRawRecording(FileRecording):
    """A `.raw` file."""

    FORMAT = "a Prophesee .raw file (EVT 2.0, 2.1, 3.0)"
    TYPE = "prophesee/raw"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration)
        with path.open("rb") as file:
            header = _read_header(file)
            self._start = file.tell()
        self.encoding = _encoding(path, header)
        self._big_endian = header.get("endianness") == "big"
        self.size = _size(header)

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return path.suffix == ".raw" and path.is_file()

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, a megabyte of words at a time."""
        return self.checked(self._decode(), since)

    def _decode(self) -> Iterator[Events]:
        decoder = make_packet_decoder(self.encoding, Statistics())
        with self.path.open("rb") as file:
            file.seek(self._start)
            while data := file.read(_CHUNK_BYTES):
                yield decoder.decode(memoryview(data), self._big_endian, 0)


def _read_header(file: BinaryIO) -> dict[str, str]:
    """Read `% keyword value` lines and leave the file at the first byte of data."""
    header: dict[str, str] = {}
    for _ in range(_MAX_HEADER_LINES):
        start = file.tell()
        line = file.readline(4096)
        if not line.startswith(b"% "):
            file.seek(start)
            break
        keyword, _, value = line[2:].decode("ascii", "replace").strip().partition(" ")
        if keyword == "end":
            break
        header[keyword] = value
    return header


def _encoding(path: Path, header: dict[str, str]) -> str:
    """Find the encoding in `format EVT3;height=720;width=1280` or `evt 3.0`."""
    name = header.get("format", "").partition(";")[0] or _VERSIONS.get(header.get("evt", ""), "")
    if name not in _ENCODINGS:
        given = f"of format '{name}'" if name else "without a format in its header"
        raise InputError(path, f"a .raw file {given}", f"record {' or '.join(_ENCODINGS)}")
    return _ENCODINGS[name]


def _size(header: dict[str, str]) -> tuple[int, int]:
    """Find the sensor's size in `geometry 1280x720` or in the format's options."""
    if found := re.fullmatch(r"(\d+)x(\d+)", header.get("geometry", "")):
        return int(found[1]), int(found[2])
    options = dict(re.findall(r"(width|height)=(\d+)", header.get("format", "")))
    return int(options.get("width", 0)), int(options.get("height", 0))
