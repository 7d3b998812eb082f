"""Twists: at a known speed, in another frame; and the speeds known from elsewhere."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.estimate import Estimate

_KEPT_SPEEDS = 1000  # speeds: seconds of any odometry


@dataclass(frozen=True)
class Twist:
    """Motion of the camera at one time, in its optical frame or one that is fixed to it.

    Attributes:
        t: event time, ns.
        linear: (3,) unit direction of the velocity, or m/s at a known speed; zeros where it is
            not observable.
        angular: (3,) rad/s.
    """

    t: int
    linear: NDArray[np.float64]
    angular: NDArray[np.float64]

    def at_speed(self, speed: float) -> "Twist":
        """Return the twist of a camera that moves at this speed (m/s)."""
        return replace(self, linear=speed * self.linear)

    def in_frame(self, rotation: NDArray[np.float64]) -> "Twist":
        """Express the same motion of the same point, the camera's centre, along other axes.

        Args:
            rotation: (3, 3), from the axes of this twist to the others.
        """
        return replace(self, linear=rotation @ self.linear, angular=rotation @ self.angular)


@dataclass(frozen=True)
class PresentTwist:
    """The motion at the newest event (core.products.present_motion).

    Attributes:
        twist: linear is a unit direction, or zero where it is not observable.
        covariance: (6, 6) of (linear, angular), as that of an Estimate.
    """

    twist: Twist
    covariance: NDArray[np.float64]


def covariance_at_speed(covariance: NDArray[np.float64], speed: float) -> NDArray[np.float64]:
    """Scale the (6, 6) covariance of (direction, angular) to a speed (m/s) that is known exactly.

    One that says that translation is not observable ([0, 0] is -1) is returned as it is.
    """
    if covariance[0, 0] < 0:
        return covariance
    scale = np.array([speed] * 3 + [1.0] * 3)
    return covariance * np.outer(scale, scale)


def covariance_in_frame(
    covariance: NDArray[np.float64], rotation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Express the (6, 6) covariance of (linear, angular) along other axes, as `Twist.in_frame`.

    One that says that translation is not observable ([0, 0] is -1) goes on saying so; the
    angular part is rotated.
    """
    both = np.kron(np.eye(2), rotation)
    rotated: NDArray[np.float64] = both @ covariance @ both.T
    if covariance[0, 0] < 0:
        rotated[:3], rotated[:, :3] = covariance[:3], covariance[:, :3]
    return rotated


def at_middle(estimate: Estimate) -> Twist:
    """Return the twist at the time that the estimate's own values hold at."""
    return Twist(estimate.t, estimate.linear, estimate.angular)


class SpeedLog:
    """The latest speeds, and what they were at the time of a window. Times are in ns."""

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=_KEPT_SPEEDS)
        self._speeds: deque[float] = deque(maxlen=_KEPT_SPEEDS)

    def add(self, t: int, speed: float) -> None:
        """Add a speed (m/s). One from before the last, as in a bag that loops, begins anew."""
        if self._times and t < self._times[-1]:
            self._times.clear()
            self._speeds.clear()
        self._times.append(t)
        self._speeds.append(speed)

    def at(self, t: int, max_age: int) -> float | None:
        """Interpolate linearly at time t; None if no speed is from within max_age of it."""
        since = np.array(self._times, np.int64) - t
        if not (np.abs(since) <= max_age).any():
            return None
        return float(np.interp(0.0, since, self._speeds))
