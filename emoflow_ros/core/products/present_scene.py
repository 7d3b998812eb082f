"""What a window has shown near its end, for the latest twist."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.measurement import Shape, fit_shape
from emoflow_ros.core.products.known_scene import KnownScene
from emoflow_ros.core.products.settings import PRESENT
from emoflow_ros.core.types.estimate import SpeedBound
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.gyro import GyroReadings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SeenScene:
    """What a window has shown near its end.

    Attributes:
        t: the time that motion and scene hold at, ns.
        valid_until: the last time that it tells of, ns.
        length_ns: of the window.
        motion: (6,) w in rad/s and the unit direction v.
        angular_acceleration: (3,) mean over the window, rad/s^2.
        covariance: (6, 6) of the motion.
        drift: (6,) variance of its change per s.
        known: the scene; None where the window had no flow.
        translates: whether v is known.
        gyro: what the gyro measures around t, or None.
        bound: of the speed of later events, or None.
        measured: whether the window's own events told the motion.
    """

    t: int
    valid_until: int
    length_ns: int
    motion: Array
    angular_acceleration: Array
    covariance: Array
    drift: Array
    known: KnownScene | None
    translates: bool
    gyro: Shape | None
    bound: SpeedBound | None = None
    measured: bool = True

    def predicted_change(self, t: int) -> Array:
        """Change of w (3,) from the scene's time to t, ns: as in the window, but it fades."""
        ahead, fades = (t - self.t) / NS_PER_S, min(PRESENT.fades_s, self.length_ns / NS_PER_S)
        seconds = -fades * np.expm1(-ahead / fades) if ahead > 0 else ahead
        return self.angular_acceleration * seconds

    def change_by_gyro(self, gyro: GyroReadings | None, t: int) -> tuple[Array, float] | None:
        """Change of w (3,) since the scene was seen as a gyro tells it, bias and all.

        Returns:
            The change, rad/s, and its variance in each axis. None without readings.
        """
        now = measured(gyro, t)
        if now is None or self.gyro is None:
            return None
        change = now.coefficients[0] - self.gyro.coefficients[0]
        return change, PRESENT.gyro_error**2 + now.gap_variance + self.gyro.gap_variance


def measured(gyro: GyroReadings | None, t: int) -> Shape | None:
    """What a gyro's readings tell around a time; None if they are not there or not finite."""
    if gyro is None:
        return None
    start, end = t - PRESENT.mean_ns, t + PRESENT.mean_ns
    near = gyro.covering(start, end)
    if len(near) == 0 or not np.isfinite(near.w).all():
        return None
    return fit_shape(near, start, end)
