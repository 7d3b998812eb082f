"""Readers of recordings of every file format, without ROS.

One file is one format; its line in `READERS` registers it.
"""

from pathlib import Path
from typing import Any

from emoflow_ros.errors import InputError
from emoflow_ros.readers.aedat4 import Aedat4Recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.column_layout import ColumnOptions
from emoflow_ros.readers.dsec import DsecRecording
from emoflow_ros.readers.ecd import EcdRecording
from emoflow_ros.readers.hdf5_columns import ColumnsRecording
from emoflow_ros.readers.mvsec import MvsecRecording
from emoflow_ros.readers.numpy_arrays import NumpyRecording
from emoflow_ros.readers.prophesee_raw import PropheseeRawRecording
from emoflow_ros.readers.reader_base import Recording, require_camera, unordered
from emoflow_ros.readers.unknown_files import refuse_unknown

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
    NumpyRecording,
)
# Of these the user can say the unit of time, and of some which column is which.
_OF_COLUMNS = (EcdRecording, MvsecRecording, DsecRecording, ColumnsRecording, NumpyRecording)
_OF_ANY_ORDER = (EcdRecording, ColumnsRecording, NumpyRecording)
_NAMES = [reader.FORMAT for reader in READERS]
KNOWN_FORMATS = f"{', '.join(_NAMES[:-1])} or {_NAMES[-1]}"


def open_recording(
    path: Path,
    *,
    topic: str | None = None,
    calibration: Path | None = None,
    columns: ColumnOptions | None = None,
) -> Recording:
    """Open a recording of any known format.

    Args:
        path: a bag (ROS 1 file, rosbag2 folder or storage file) or a data set's file or folder.
        topic: the event topic or data set inside it, where there are several.
        calibration: a calibration file that takes the place of the recording's own.
        columns: the order and unit of columns of numbers, where their values mislead.

    Returns:
        The recording, opened: use it as a context manager.

    Raises:
        InputError: no such path, no known format, or contents that cannot be used.
    """
    if not path.exists():
        raise InputError(path, "no such file or folder", "check the path")
    for reader in READERS:
        if reader.matches(path):
            return _open(reader, path, topic, calibration, columns or ColumnOptions())
    refuse_unknown(path, KNOWN_FORMATS)


def _open(
    reader: Any, path: Path, topic: str | None, calibration: Path | None, columns: ColumnOptions
) -> Recording:
    """Open a recording with its reader; refuse options that its format has no use for."""
    for option, value, takers in (
        ("--layout", columns.layout, _OF_ANY_ORDER),
        ("--time-unit", columns.time_unit, _OF_COLUMNS),
    ):
        if value and reader not in takers:
            raise InputError(option, f"the format of {path} says it", "leave the option out")
    more = {"columns": columns} if reader in _OF_COLUMNS else {}
    recording: Recording = reader(path, topic=topic, calibration=calibration, **more)
    return recording
