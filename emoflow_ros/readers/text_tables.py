"""Tables of numbers in text files: IMU readings, poses and rates."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.reader_base import Imu
from emoflow_ros.readers.stamps import distinct

IMU_FILE = "imu.txt"


def read_imu_text(path: Path) -> Imu:
    """Read ECD's `t ax ay az gx gy gz` in s, m/s^2 and rad/s.

    Raises:
        InputError: lines of another length, or times that go back.
    """
    rows = read_table(path, 7, "t ax ay az gx gy gz")
    stamps = np.rint(rows[:, 0] * NS_PER_S).astype(np.int64)
    kept = distinct(path, stamps)
    return Imu(path.name, stamps[kept], rows[kept, 4:], rows[kept, 1:4])


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
