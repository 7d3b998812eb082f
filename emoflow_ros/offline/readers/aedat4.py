"""Reader of iniVation's AEDAT4 files, through the `aedat` package."""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.offline.readers.file_recording import FileRecording


class Aedat4Recording(FileRecording):
    """An `.aedat4` file with one event stream."""

    FORMAT = "an AEDAT4 file (.aedat4)"
    TYPE = "aedat4"

    def __init__(
        self, path: Path, *, topic: str | None = None, calibration: Path | None = None
    ) -> None:
        super().__init__(path, topic=topic, calibration=calibration)
        streams = self._open().id_to_stream()
        events = {i: s for i, s in streams.items() if s["type"] == "events"}
        if len(events) != 1:
            there = ", ".join(s["type"] for s in streams.values()) or "nothing"
            raise InputError(
                path, f"{len(events)} event streams ({there})", "give a file with one event stream"
            )
        ((self._stream, stream),) = events.items()
        self.size = stream["width"], stream["height"]

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return path.suffix == ".aedat4" and path.is_file()

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, one packet of the file at a time."""
        return self.checked(self._decode(), since)

    def _decode(self) -> Iterator[Events]:
        packets = iter(self._open())
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except BaseException as error:
                self._refuse(error)
            if packet["stream_id"] == self._stream:
                yield _to_events(packet["events"])

    def _open(self) -> Any:
        try:
            aedat = import_module("aedat")
        except ImportError:
            raise InputError(
                self.path, "AEDAT4 needs the package 'aedat'", "run 'pip install aedat'"
            ) from None
        try:
            return aedat.Decoder(str(self.path))
        except BaseException as error:
            self._refuse(error)

    def _refuse(self, error: BaseException) -> Any:
        """Refuse a damaged file; a panic of the package's Rust code is no Exception."""
        if not isinstance(error, RuntimeError) and type(error).__name__ != "PanicException":
            raise error
        raise InputError(self.path, f"damaged AEDAT4 file ({error})", "copy it again") from None


def _to_events(packet: np.ndarray) -> Events:
    """Convert the structured array (t in us, x, y, on) of a packet."""
    t = packet["t"].astype(np.int64) * 1000
    return Events(packet["x"].copy(), packet["y"].copy(), t, packet["on"].copy())
