"""What a scene consists of: textured rectangles, and the smooth paths of camera and objects."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Pose = tuple[NDArray[np.float64], Vector]  # rotation world-from-body (3, 3), position (3,)

# Channels of a path.
X, Y, Z, YAW, PITCH, ROLL = range(6)

STATIC, MOVING = 0, 1  # more bodies that move by themselves are MOVING + 1, ...
_QUIET_HZ = 0.1


@dataclass(frozen=True)
class Quad:
    """A textured rectangle in the frame of the body that carries it.

    Attributes:
        corner: (3,) m.
        along_u, along_v: (3,) edges from the corner in m, at right angles to each other.
        texture: index into the texture set.
        texel: side of the finest texel in m.
        contrast: factor on the texture's log intensity.
        shade: added to the log intensity.
        body: STATIC, or MOVING plus the number of the body that moves by itself.
    """

    corner: NDArray[np.float64]
    along_u: NDArray[np.float64]
    along_v: NDArray[np.float64]
    texture: int
    texel: float
    contrast: float = 1.0
    shade: float = 0.0
    body: int = STATIC


@dataclass(frozen=True)
class Look:
    """How the faces of a room or box are painted: textures are drawn from the set."""

    textures: int
    texel: float
    contrast: float = 1.0
    body: int = STATIC


def cuboid(
    centre: tuple[float, float, float],
    size: tuple[float, float, float],
    yaw: float,
    look: Look,
    rng: np.random.Generator,
) -> list[Quad]:
    """Six faces of a box turned by `yaw` rad about the vertical (y) axis, or of a room."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    axes = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]) * np.array(size)[:, None]
    low = np.array(centre) - axes.sum(axis=0) / 2
    quads = []
    for normal in range(3):
        u, v = axes[(normal + 1) % 3], axes[(normal + 2) % 3]
        for corner in (low, low + axes[normal]):
            quads.append(
                Quad(
                    corner,
                    u,
                    v,
                    int(rng.integers(look.textures)),
                    look.texel,
                    look.contrast,
                    float(rng.normal(0, 0.25)),
                    look.body,
                )
            )
    return quads


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


@dataclass(frozen=True)
class Step:
    """A move on one channel from rest to rest, with continuous acceleration.

    Attributes:
        channel: X, Y, Z (height in m) or YAW, PITCH, ROLL (in rad).
        height: how far.
        start, duration: s.
    """

    channel: int
    height: float
    start: float
    duration: float


class Trajectory:
    """The pose of a rigid body over time.

    Position and the angles of R = Ry(yaw) Rx(pitch) Rz(roll) are each an offset plus a constant
    rate plus sinusoids plus steps. A lever l adds R l to the position: the body then turns
    about a point that is not its origin, as a camera on a pan-tilt head does. For a camera, the
    body is the optical frame; the world's y axis points down, as gravity does.

    Args:
        offset: (6,) pose at t = 0 without the waves, in m and rad.
        rate: (6,) constant rates in m/s and rad/s.
        waves: any number of sinusoids.
        steps: any number of smooth steps.
        lever: (3,) m, from the centre of rotation to the body's origin, in the body's axes.
    """

    def __init__(
        self,
        offset: tuple[float, ...] = (0.0,) * 6,
        rate: tuple[float, ...] = (0.0,) * 6,
        waves: tuple[Wave, ...] = (),
        steps: tuple[Step, ...] = (),
        lever: tuple[float, float, float] | None = None,
    ) -> None:
        self._offset = np.array(offset)
        self._rate = np.array(rate)
        self._amplitude = np.zeros((len(waves), 6))
        for row, wave in zip(self._amplitude, waves, strict=True):
            row[wave.channel] = wave.amplitude
        self._omega = 2 * np.pi * np.array([wave.frequency for wave in waves])
        self._phase = np.array([wave.phase for wave in waves])
        self._steps = steps
        self._lever = None if lever is None else np.array(lever)

    def pose(self, t: float) -> Pose:
        """Rotation world-from-body (3, 3) and position (3,) in m at time t in s."""
        q = self._channels(t, 0)
        rotation = _rotation_y(q[YAW]) @ _rotation_x(q[PITCH]) @ _rotation_z(q[ROLL])
        if self._lever is None:
            return rotation, q[:3]
        return rotation, q[:3] + rotation @ self._lever

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
        linear = rotation.T @ dq[:3]
        if self._lever is not None:
            linear = linear + np.cross(angular, self._lever)
        return linear, angular

    def acceleration(self, t: float) -> Vector:
        """Acceleration (3,) m/s^2 of the body's origin in the world's axes."""
        acceleration = self._channels(t, 2)[:3]
        if self._lever is None:
            return acceleration
        rotation, _ = self.pose(t)
        _, angular = self.twist(t)
        swing = np.cross(self.angular_acceleration(t), self._lever)
        return acceleration + rotation @ (swing + np.cross(angular, np.cross(angular, self._lever)))

    def angular_acceleration(self, t: float) -> Vector:
        """Rate of change (3,) rad/s^2 of the angular velocity in the body's axes."""
        q, dq, ddq = (self._channels(t, order) for order in range(3))
        sin_pitch, cos_pitch = np.sin(q[PITCH]), np.cos(q[PITCH])
        sin_roll, cos_roll = np.sin(q[ROLL]), np.cos(q[ROLL])
        # The yaw and pitch axes in the body's axes, and how they turn.
        yaw = np.array([sin_roll * cos_pitch, cos_roll * cos_pitch, -sin_pitch])
        yaw_rate = dq[ROLL] * np.array([yaw[1], -yaw[0], 0.0]) - dq[PITCH] * np.array(
            [sin_roll * sin_pitch, cos_roll * sin_pitch, cos_pitch]
        )
        pitch = np.array([cos_roll, -sin_roll, 0.0])
        pitch_rate = dq[ROLL] * np.array([-sin_roll, -cos_roll, 0.0])
        turning = dq[YAW] * yaw_rate + dq[PITCH] * pitch_rate
        return np.asarray(ddq[YAW] * yaw + ddq[PITCH] * pitch + (0.0, 0.0, ddq[ROLL]) + turning)

    def _channels(self, t: float, order: int) -> Vector:
        """The order-th derivative of the six channels."""
        shifted = self._omega * t + self._phase + order * np.pi / 2
        waves = (self._omega**order * np.sin(shifted)) @ self._amplitude
        if order == 0:
            waves = waves + self._offset + self._rate * t
        elif order == 1:
            waves = waves + self._rate
        for step in self._steps:
            waves[step.channel] += _step(step, t, order)
        return np.asarray(waves)


@dataclass(frozen=True)
class Scene:
    """Surfaces and motions, in a world with x right, y down and z forward at the start.

    Attributes:
        quads: all surfaces, each in the frame of the body that carries it.
        camera: world-from-camera.
        movers: world-from-body of each body that moves by itself: bodies MOVING, MOVING + 1, ...
        noise_hz: background events per second and pixel; dim scenes have more.
    """

    quads: tuple[Quad, ...]
    camera: Trajectory
    movers: tuple[Trajectory, ...] = ()
    noise_hz: float = _QUIET_HZ

    def poses(self, t: float) -> tuple[Pose, tuple[Pose, ...]]:
        """Poses at t in s: the camera's, and those of the bodies STATIC, MOVING and so on."""
        rest = (np.eye(3), np.zeros(3))
        return self.camera.pose(t), (rest, *(mover.pose(t) for mover in self.movers))


def _step(step: Step, t: float, order: int) -> float:
    """The order-th derivative of h (6 s^5 - 15 s^4 + 10 s^3), s from 0 to 1 over the step."""
    s = min(max((t - step.start) / step.duration, 0.0), 1.0)
    if order == 0:
        return step.height * s**3 * (10 + s * (6 * s - 15))
    if order == 1:
        return step.height / step.duration * 30 * (s * (1 - s)) ** 2
    return step.height / step.duration**2 * 60 * s * (1 - s) * (1 - 2 * s)


def _rotation_x(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _rotation_y(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _rotation_z(angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
