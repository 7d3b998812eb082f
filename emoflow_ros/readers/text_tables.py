"""Tables of numbers in text files: IMU readings, poses and rates."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.reader_base import Imu

IMU_FILE = "imu.txt"


def read_imu_text(path: Path) -> Imu:
    """Read ECD's `t ax ay az gx gy gz` in s, m/s^2 and rad/s.

    Raises:
        InputError: lines of another length, or times that do not increase.
    """
    stamps, rows = _read_stamped(path, 7, "t ax ay az gx gy gz")
    return Imu(path.name, stamps, rows[:, 3:], rows[:, :3])


def read_table(path: Path, columns: int, layout: str) -> NDArray[np.float64]:
    """Read lines of so many numbers, (N, columns) with N > 0; `#` begins a comment.

    Args:
        path: the file.
        columns: numbers in a line.
        layout: their names, for errors.

    Raises:
        InputError: not such a file.
    """
    fix = f"give lines '{layout}'"
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(path, f"not a table of numbers ({error})", fix) from None
    if rows.size == 0 or rows.shape[1] != columns:
        raise InputError(path, f"lines of {rows.shape[1]} numbers", fix)
    return rows


def _read_stamped(
    path: Path, columns: int, layout: str
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Read a table whose first column is the time in s: times (N,) in ns, and the other columns.

    Raises:
        InputError: see `read_table`, or times that do not increase.
    """
    rows = read_table(path, columns, layout)
    stamps = np.rint(rows[:, 0] * NS_PER_S).astype(np.int64)
    require_increasing(path, stamps)
    return stamps, rows[:, 1:]


def require_increasing(path: Path, stamps: NDArray[np.int64]) -> None:
    """Check that times (N,) in ns increase.

    Raises:
        InputError: they do not.
    """
    if (np.diff(stamps) <= 0).any():
        raise InputError(path, "times are not increasing", "sort the lines by time")
