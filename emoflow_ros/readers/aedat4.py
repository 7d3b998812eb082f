"""Reader of iniVation's AEDAT4 files, through the `aedat` package."""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import Events
from emoflow_ros.errors import InputError
from emoflow_ros.readers.reader_base import FileRecording, Imu, refuse_imu_topic

# The format has the acceleration in g and the rotation in deg/s.
_ACCELERATION = ("accelerometer_x", "accelerometer_y", "accelerometer_z")
_ANGULAR = ("gyroscope_x", "gyroscope_y", "gyroscope_z")
_G = 9.80665  # m/s^2


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
        self._imu = next((i for i, s in streams.items() if s["type"] == "imus"), None)

    @staticmethod
    def matches(path: Path) -> bool:
        """Whether the path is a file of this format."""
        return path.suffix == ".aedat4" and path.is_file()

    def event_chunks(self, since: int | None = None) -> Iterator[Events]:
        """Stream the events, one packet of the file at a time."""
        packets = self._packets()
        events = (_to_events(p["events"]) for p in packets if p["stream_id"] == self._stream)
        return self.checked(events, since)

    def imu(self, topic: str | None = None) -> Imu | None:
        """Read the first IMU stream, which the events are read over for; see Recording."""
        refuse_imu_topic(self.path, topic)
        if self._imu is None:
            return None
        packets = [p["imus"] for p in self._packets() if p["stream_id"] == self._imu]
        if not packets:
            return None
        rows = np.concatenate(packets)
        acceleration = np.stack([rows[name] for name in _ACCELERATION], axis=1)
        angular = np.stack([rows[name] for name in _ANGULAR], axis=1)
        return Imu(
            self.file_name,
            rows["t"].astype(np.int64) * 1000,
            np.radians(angular.astype(np.float64)),
            acceleration.astype(np.float64) * _G,
        )

    def _packets(self) -> Iterator[dict[str, Any]]:
        packets = iter(self._open())
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except BaseException as error:
                self._refuse(error)
            yield packet

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


def _to_events(packet: NDArray[np.void]) -> Events:
    """Convert the structured array (t in us, x, y, on) of a packet."""
    t = packet["t"].astype(np.int64) * 1000
    return Events(packet["x"].copy(), packet["y"].copy(), t, packet["on"].copy())
