"""MVSEC's `<sequence>_odom.npz`: the data set's own, smoothed velocities."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import TrueTwist

_FIX = "give MVSEC's <sequence>_odom.npz"


class SmoothedOdometry:
    """Velocities as the file has them, in the left camera's frame, linear between its stamps.

    They are differences of consecutive poses that went through a mean over 21 of them, in
    place, so that the ten before each are smoothed already: at 20 frames per second, 28 % of a
    1 Hz oscillation are left, 0.2 s early. They serve comparison with figures that were
    computed from them. The file's orientations are not usable (all four components were written
    to one column), so there are no poses in it.

    Raises:
        InputError: not such a file.
    """

    name = "MVSEC's odometry"

    def __init__(self, path: Path) -> None:
        try:
            with np.load(path) as archive:
                seconds, linear, angular = (
                    np.asarray(archive[key], np.float64)
                    for key in ("timestamps", "lin_vel", "ang_vel")
                )
        except (OSError, KeyError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(path, f"not an odometry file ({reason})", _FIX) from None
        count = len(seconds)
        if seconds.shape != (count,) or {linear.shape, angular.shape} != {(count, 3)}:
            raise InputError(path, "timestamps, lin_vel and ang_vel differ in length", _FIX)
        if (np.diff(seconds) <= 0).any():
            raise InputError(path, "times are not increasing", _FIX)
        self.stamps = np.rint(seconds * NS_PER_S).astype(np.int64)
        self._values = np.hstack([angular, linear])
        self.description = (
            f"velocity: {path.name}, smoothed by the data set (recursive mean over 21 frames), "
            "linear between its stamps"
        )

    def twist(self, t: int) -> TrueTwist | None:
        """Velocity at time t (ns); None outside the stamps."""
        stamps = self.stamps
        if len(stamps) < 2 or not stamps[0] <= t <= stamps[-1]:
            return None
        after = int(np.clip(np.searchsorted(stamps, t), 1, len(stamps) - 1))
        share = (t - stamps[after - 1]) / (stamps[after] - stamps[after - 1])
        value: NDArray[np.float64] = (1 - share) * self._values[after - 1]
        value = value + share * self._values[after]
        return TrueTwist(angular=value[:3], linear=value[3:])
