"""Smooth 6-DoF paths as sums of sinusoids, with derivatives in closed form."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Pose = tuple[NDArray[np.float64], Vector]  # rotation world-from-body (3, 3), position (3,)

# Channels of a path.
X, Y, Z, YAW, PITCH, ROLL = range(6)


@dataclass(frozen=True)
class Wave:
    """One sinusoid on one channel: amplitude * sin(2 pi frequency t + phase).

    Attributes:
        channel: X, Y, Z (amplitude in m) or YAW, PITCH, ROLL (in rad).
        amplitude, frequency, phase: in the channel's unit, Hz and rad.
    """

    channel: int
    amplitude: float
    frequency: float
    phase: float


class Trajectory:
    """The pose of a rigid body over time.

    Position and the angles of R = Ry(yaw) Rx(pitch) Rz(roll) are each an offset plus a constant
    rate plus sinusoids. For a camera, the body is the optical frame; the world's y axis
    points down, as gravity does.

    Args:
        offset: (6,) pose at t = 0 without the waves, in m and rad.
        rate: (6,) constant rates in m/s and rad/s.
        waves: any number of sinusoids.
    """

    def __init__(
        self,
        offset: tuple[float, ...] = (0.0,) * 6,
        rate: tuple[float, ...] = (0.0,) * 6,
        waves: tuple[Wave, ...] = (),
    ) -> None:
        self._offset = np.array(offset)
        self._rate = np.array(rate)
        self._amplitude = np.zeros((len(waves), 6))
        for row, wave in zip(self._amplitude, waves, strict=True):
            row[wave.channel] = wave.amplitude
        self._omega = 2 * np.pi * np.array([wave.frequency for wave in waves])
        self._phase = np.array([wave.phase for wave in waves])

    def pose(self, t: float) -> Pose:
        """Rotation world-from-body (3, 3) and position (3,) in m at time t in s."""
        q = self._channels(t, 0)
        return _rotation_y(q[YAW]) @ _rotation_x(q[PITCH]) @ _rotation_z(q[ROLL]), q[:3]

    def twist(self, t: float) -> tuple[Vector, Vector]:
        """Linear velocity (3,) m/s and angular velocity (3,) rad/s, both in the body's axes."""
        rotation, _ = self.pose(t)
        q, dq = self._channels(t, 0), self._channels(t, 1)
        roll_from_pitch = _rotation_z(q[ROLL]).T
        # Body rates of the yaw-pitch-roll sequence: each rate about its own axis, seen from
        # behind the rotations that follow it.
        angular = (
            roll_from_pitch @ _rotation_x(q[PITCH]).T @ (0.0, dq[YAW], 0.0)
            + roll_from_pitch @ (dq[PITCH], 0.0, 0.0)
            + (0.0, 0.0, dq[ROLL])
        )
        return rotation.T @ dq[:3], angular

    def acceleration(self, t: float) -> Vector:
        """Acceleration (3,) m/s^2 of the body's origin in the world's axes."""
        return self._channels(t, 2)[:3]

    def _channels(self, t: float, order: int) -> Vector:
        """The order-th derivative of the six channels."""
        shifted = self._omega * t + self._phase + order * np.pi / 2
        waves = (self._omega**order * np.sin(shifted)) @ self._amplitude
        if order == 0:
            waves = waves + self._offset + self._rate * t
        elif order == 1:
            waves = waves + self._rate
        return np.asarray(waves)


def _rotation_x(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _rotation_y(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _rotation_z(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
