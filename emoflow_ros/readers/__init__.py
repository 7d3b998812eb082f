"""Readers of recordings of every file format, without ROS.

One file is one format; its line in `READERS` registers it.
"""

from pathlib import Path

from emoflow_ros.errors import InputError
from emoflow_ros.readers.aedat4 import Aedat4Recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.dsec import DsecRecording
from emoflow_ros.readers.ecd import EcdRecording
from emoflow_ros.readers.hdf5_columns import ColumnsRecording
from emoflow_ros.readers.mvsec import MvsecRecording
from emoflow_ros.readers.npz import NpzRecording
from emoflow_ros.readers.prophesee_raw import PropheseeRawRecording
from emoflow_ros.readers.reader_base import Recording, require_camera, unordered

__all__ = [
    "KNOWN_FORMATS",
    "READERS",
    "Recording",
    "open_recording",
    "require_camera",
    "unordered",
]
# The first whose `matches(path)` holds opens the recording.
READERS = (
    BagRecording,
    EcdRecording,
    PropheseeRawRecording,
    Aedat4Recording,
    MvsecRecording,
    DsecRecording,
    ColumnsRecording,
    NpzRecording,
)
_NAMES = [reader.FORMAT for reader in READERS]
KNOWN_FORMATS = f"{', '.join(_NAMES[:-1])} or {_NAMES[-1]}"


def open_recording(
    path: Path, *, topic: str | None = None, calibration: Path | None = None
) -> Recording:
    """Open a recording of any known format.

    Args:
        path: a bag (ROS 1 file, rosbag2 folder or storage file) or a data set's file or folder.
        topic: the event topic or data set inside it, where there are several.
        calibration: a calibration file that takes the place of the recording's own.

    Returns:
        The recording, opened: use it as a context manager.

    Raises:
        InputError: no such path, no known format, or contents that cannot be used.
    """
    if not path.exists():
        raise InputError(path, "no such file or folder", "check the path")
    for reader in READERS:
        if reader.matches(path):
            return reader(path, topic=topic, calibration=calibration)
    raise InputError(path, "not a recording of a known format", f"give {KNOWN_FORMATS}")
