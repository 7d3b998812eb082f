"""What a window has shown near its end, and how the motion changes since: for the latest twist."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.measurement import Shape, fit_shape
from emoflow_ros.core.products.known_scene import KnownScene
from emoflow_ros.core.products.settings import PRESENT
from emoflow_ros.core.types.estimate import SpeedBound
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
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
        drift: (6,) variance of its change per s: of w, and of v in units of the speed.
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

    def expected(self, t: int, before: "Change | None") -> "Change":
        """The change until a time, ns, before its events are looked at.

        Nobody knows how the speed changes: its standard deviation is the speed itself. What the
        slice before has shown goes on. Of another window's scene that is w alone: both windows tell
        it, each as well as it knows.

        Args:
            t: later than that of `before`.
            before: what the slice before has shown; None if there is none.
        """
        v, covariance = self.motion[3:], np.zeros((6, 6))
        covariance[3:, 3:] = np.outer(v, v)
        anew = Change(self, self.t, np.zeros(6), covariance)
        if before is None:
            return anew.carried_on(t)
        if before.scene is self:
            return before.carried_on(t)
        return anew.carried_on(t).together(before)

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


@dataclass(frozen=True)
class Change:
    """How the motion has changed since a window has shown a scene.

    Attributes:
        scene: that the window has shown.
        t: until when, ns.
        mean: (6,) of w, rad/s, and of v, in units of the speed.
        covariance: (6, 6); the error of the window's own motion is none of the change's.
    """

    scene: SeenScene
    t: int
    mean: Array
    covariance: Array

    def carried_on(self, t: int) -> "Change":
        """The same until a time, ns: by the window's own change of w and a random walk."""
        ahead = self.scene.predicted_change(t) - self.scene.predicted_change(self.t)
        mean = self.mean + np.concatenate([ahead, np.zeros(3)])
        # not nothing, for the covariance is inverted
        walk = self.scene.drift * (max(t - self.t, NS_PER_MS) / NS_PER_S)
        return Change(self.scene, t, mean, self.covariance + np.diag(walk))

    def by_gyro(self, change: Array, variance: float) -> "Change":
        """The same with w's change (3,) rad/s by a gyro, with a variance in each axis."""
        mean, covariance = self.mean.copy(), self.covariance.copy()
        covariance[:3], covariance[:, :3] = 0.0, 0.0
        mean[:3], covariance[:3, :3] = change, variance * np.eye(3)
        return replace(self, mean=mean, covariance=covariance)

    def together(self, other: "Change") -> "Change":
        """The same with the w that an earlier change since another window's scene leads to."""
        scene, earlier = self.scene, other.scene
        later = other.carried_on(self.t)
        w = earlier.motion[:3] + later.mean[:3] - scene.motion[:3]
        of_windows = earlier.covariance[:3, :3] + scene.covariance[:3, :3]
        of_w = later.covariance[:3, :3] + of_windows
        mean, covariance = self.mean.copy(), self.covariance.copy()
        share = covariance[:3, :3] @ np.linalg.inv(covariance[:3, :3] + of_w)
        mean[:3] += share @ (w - mean[:3])
        covariance[:3, :3] = share @ of_w
        return replace(self, mean=mean, covariance=covariance)


def measured(gyro: GyroReadings | None, t: int) -> Shape | None:
    """What a gyro's readings tell around a time; None if they are not there or not finite."""
    if gyro is None:
        return None
    start, end = t - PRESENT.mean_ns, t + PRESENT.mean_ns
    near = gyro.covering(start, end)
    if len(near) == 0 or not np.isfinite(near.w).all():
        return None
    return fit_shape(near, start, end)
