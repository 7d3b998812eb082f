"""A recording's IMU: its readings as arrays, in SI units and in the IMU's own axes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.offline.text_table import read_stamped


@dataclass(frozen=True)
class Imu:
    """Readings of one IMU.

    Attributes:
        name: the topic or the file's name.
        t: (N,) int64 ns, in the order of the recording.
        angular: (N, 3) rad/s.
        acceleration: (N, 3) m/s^2, specific force; None where the IMU has no accelerometer.
    """

    name: str
    t: NDArray[np.int64]
    angular: NDArray[np.float64]
    acceleration: NDArray[np.float64] | None

    def __len__(self) -> int:
        return len(self.t)

    @property
    def rate(self) -> float:
        """Readings per second, by the median time between two; NaN with fewer than two."""
        if len(self.t) < 2:
            return float("nan")
        step = float(np.median(np.diff(self.t)))
        return NS_PER_S / step if step > 0 else float("nan")


def read_imu_text(path: Path) -> Imu:
    """Read ECD's `t ax ay az gx gy gz` in s, m/s^2 and rad/s.

    Raises:
        InputError: lines of another length, or times that do not increase.
    """
    stamps, rows = read_stamped(path, 7, "t ax ay az gx gy gz")
    return Imu(path.name, stamps, rows[:, 3:], rows[:, :3])
