"""Exact truth of a simulated recording: poses, twist, depth, flow, and what an IMU measures."""

import dataclasses
import math
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S
from emoflow_ros.core.types.options import option
from emoflow_ros.simulation.raycast import RayCaster, exact_bearings
from emoflow_ros.simulation.scene import MOVING, Pose, Scene

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 9.81, 0.0])  # m/s^2; the world's y axis points down


class GroundTruth:
    """True motion, depth and flow. Times are ns; images are (H, W) on the camera's pixel grid.

    Pixels whose ray the lens model does not define, or whose point is behind the camera at the
    second time, are NaN.

    Args:
        camera: the camera, lens included.
        scene: surfaces and motions.
        start: time at which the scene's motions start, ns.
    """

    def __init__(self, camera: Camera, scene: Scene, start: int) -> None:
        self._camera = camera
        self._scene = scene
        self._caster = RayCaster(camera, scene.quads)
        self._start = start
        bearings = exact_bearings(camera)
        self._rays = np.concatenate([bearings, np.ones((*bearings.shape[:2], 1))], axis=-1)
        self._pixels = camera.project(self._rays)
        self._last: tuple[int, tuple[Array, NDArray[np.int64]]] | None = None

    def pose(self, t: int) -> NDArray[np.float64]:
        """World-from-camera transform, (4, 4), metres."""
        transform = np.eye(4)
        transform[:3, :3], transform[:3, 3] = self._scene.camera.pose(self._seconds(t))
        return transform

    def twist(self, t: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Linear (3,) m/s and angular (3,) rad/s velocity of the camera in its optical frame."""
        return self._scene.camera.twist(self._seconds(t))

    def acceleration(self, t: int) -> NDArray[np.float64]:
        """Acceleration (3,) m/s^2 of the camera's centre in the world's axes."""
        return self._scene.camera.acceleration(self._seconds(t))

    def depth(self, t: int) -> Array:
        """Depth along the optical axis, (H, W) m."""
        return self._cast(t)[0].copy()

    def moving_mask(self, t: int) -> NDArray[np.bool_]:
        """Pixels (H, W) that see an object that moves by itself."""
        return np.asarray(self._cast(t)[1] >= MOVING)

    def flow(self, t: int) -> Array:
        """Instantaneous motion field of the distorted image, (H, W, 2) px/s."""
        depth, body = self._cast(t)
        points = self._rays * depth[..., None]
        linear, angular = self.twist(t)
        velocity = -linear - np.cross(angular, points)
        for k in range(len(self._scene.movers)):
            on_mover = body == MOVING + k
            velocity[on_mover] += self._mover_velocity(k, t, points[on_mover])
        # d(X/Z)/dt, then through the lens.
        normalised = (velocity[..., :2] - self._rays[..., :2] * velocity[..., 2:]) / depth[
            ..., None
        ]
        _, lens = self._camera.distort(self._rays[..., :2])
        focal = (self._camera.fx, self._camera.fy)
        return np.asarray(np.einsum("...ij,...j->...i", lens, normalised) * focal)

    def displacement(self, t0: int, t1: int) -> Array:
        """Displacement (H, W, 2) px from t0 to t1 of the scene points that pixels see at t0."""
        depth, body = self._cast(t0)
        points = self._rays * depth[..., None]
        moved = _transform(self._from_to(t0, t1), points)
        for k in range(len(self._scene.movers)):
            on_mover = body == MOVING + k
            moved[on_mover] = _transform(self._mover_from_to(k, t0, t1), points[on_mover])
        moved[moved[..., 2] <= 0] = np.nan
        return self._camera.project(moved) - self._pixels

    def rectified(self) -> "GroundTruth":
        """The same truth on the pixel grid of the camera without its lens distortion."""
        ideal = dataclasses.replace(self._camera, model="none", distortion=())
        return GroundTruth(ideal, self._scene, self._start)

    def _seconds(self, t: int) -> float:
        return (t - self._start) / NS_PER_S

    def _cast(self, t: int) -> tuple[Array, NDArray[np.int64]]:
        """Depth and bodies; keeps the last cast, as callers ask for several images of a time."""
        if self._last is None or self._last[0] != t:
            self._last = t, self._caster.cast(*self._scene.poses(self._seconds(t)))
        return self._last[1]

    def _mover_velocity(self, k: int, t: int, points: Array) -> Array:
        """Velocity of points (N, 3) on mover k against the world, in the camera's axes."""
        seconds = self._seconds(t)
        linear, angular = self._scene.movers[k].twist(seconds)
        rotation, position = self._in_camera(k, t)
        in_body = (points - position) @ rotation
        return np.asarray((linear + np.cross(angular, in_body)) @ rotation.T)

    def _in_camera(self, k: int, t: int) -> Pose:
        """Pose camera-from-mover of mover k."""
        (rotation, position), bodies = self._scene.poses(self._seconds(t))
        mover_rotation, mover_position = bodies[MOVING + k]
        return rotation.T @ mover_rotation, rotation.T @ (mover_position - position)

    def _from_to(self, t0: int, t1: int) -> NDArray[np.float64]:
        """Static points: camera at t1 from camera at t0, (4, 4)."""
        return np.asarray(np.linalg.inv(self.pose(t1)) @ self.pose(t0))

    def _mover_from_to(self, k: int, t0: int, t1: int) -> NDArray[np.float64]:
        """Points on mover k: camera at t1 from camera at t0, (4, 4)."""
        before, after = np.eye(4), np.eye(4)
        before[:3, :3], before[:3, 3] = self._in_camera(k, t0)
        after[:3, :3], after[:3, 3] = self._in_camera(k, t1)
        return np.asarray(after @ np.linalg.inv(before))


@dataclass(frozen=True)
class ImuModel:
    """Rate, errors and mounting of a simulated IMU; the defaults are a usual consumer IMU.

    Bias and scale of each axis are drawn once, from normal distributions of these widths.
    """

    rate_hz: float = option(1000.0, "readings per second", minimum=1.0, maximum=10_000.0)
    noise: float = option(
        0.01, "noise density of the gyro, deg/s per square root of Hz", minimum=0.0, maximum=100.0
    )
    bias: float = option(
        1.0, "standard deviation of the gyro's bias, deg/s", minimum=0.0, maximum=100.0
    )
    bias_walk: float = option(
        0.02,
        "random walk of that bias, deg/s per square root of a second",
        minimum=0.0,
        maximum=100.0,
    )
    scale_error: float = option(
        0.01, "standard deviation of the gyro's scale", minimum=0.0, maximum=0.5
    )
    range: float = option(
        2000.0, "largest angular velocity, deg/s; 0 is without limit", minimum=0.0, maximum=1e5
    )
    force_noise: float = option(
        0.002,
        "noise density of the accelerometer, m/s^2 per square root of Hz",
        minimum=0.0,
        maximum=10.0,
    )
    force_bias: float = option(
        0.1, "standard deviation of the accelerometer's bias, m/s^2", minimum=0.0, maximum=10.0
    )
    offset_ms: float = option(
        0.0,
        "events' time minus the IMU's stamps, ms: the right value of imu.time_offset_ms",
        minimum=-1000.0,
        maximum=1000.0,
    )
    roll: float = option(
        0.0,
        "orientation in the optical frame, degrees: roll about x, first",
        minimum=-360.0,
        maximum=360.0,
    )
    pitch: float = option(0.0, "then pitch about y, degrees", minimum=-360.0, maximum=360.0)
    yaw: float = option(0.0, "then yaw about z, degrees", minimum=-360.0, maximum=360.0)

    @property
    def rotation(self) -> Array:
        """From the IMU's axes to the optical frame, (3, 3)."""
        angles = (self.roll, self.pitch, self.yaw)
        return np.asarray(Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), np.float64)


# No noise, no bias, no scale error and no limit: the IMU measures the true motion.
PERFECT = {
    "noise": 0.0,
    "bias": 0.0,
    "bias_walk": 0.0,
    "scale_error": 0.0,
    "range": 0.0,
    "force_noise": 0.0,
    "force_bias": 0.0,
}


@dataclass(frozen=True)
class SimulatedImu:
    """What the IMU measured.

    Attributes:
        stamps: (N,) int64 ns, by the IMU's clock.
        angular: (N, 3) rad/s in the IMU's axes.
        force: (N, 3) m/s^2, specific force, in the IMU's axes.
        bias: (3,) of the gyro at the start, rad/s.
    """

    stamps: NDArray[np.int64]
    angular: Array
    force: Array
    bias: Array


def simulate_imu(
    truth: GroundTruth, t_start: int, t_end: int, model: ImuModel, seed: int
) -> SimulatedImu:
    """Let an IMU in the camera's centre measure [t_start, t_end), ns.

    A separate random generator draws its errors, so they do not change the events.
    """
    t = reading_times(t_start, t_end, model.rate_hz)
    twists = [truth.twist(int(time))[1] for time in t]
    angular, bias = measure_rotation(np.array(twists).reshape(-1, 3), model, seed)
    forces = [
        truth.pose(int(time))[:3, :3].T @ (truth.acceleration(int(time)) - GRAVITY) for time in t
    ]
    rng = _generator(seed, "accelerometer")
    force = np.array(forces).reshape(-1, 3) @ model.rotation
    force += model.force_bias * rng.normal(size=3)
    force += model.force_noise * math.sqrt(model.rate_hz) * rng.normal(size=force.shape)
    return SimulatedImu(t - round(model.offset_ms * NS_PER_MS), angular, force, bias)


def reading_times(t_start: int, t_end: int, rate_hz: float) -> NDArray[np.int64]:
    """Times (N,) of readings from t_start on, before t_end; ns."""
    count = math.ceil((t_end - t_start) * rate_hz / NS_PER_S)
    return t_start + np.rint(np.arange(count) * (NS_PER_S / rate_hz)).astype(np.int64)


def measure_rotation(true: Array, model: ImuModel, seed: int) -> tuple[Array, Array]:
    """Add a gyro's errors to true angular velocities.

    Args:
        true: (N, 3) rad/s in the optical frame, at the model's rate.
        model: of the gyro.
        seed: of its errors.

    Returns:
        Readings (N, 3) rad/s in the gyro's axes, and its bias (3,) at the start.
    """
    rng = _generator(seed, "gyro")
    bias = np.radians(model.bias) * rng.normal(size=3)
    scale = 1 + model.scale_error * rng.normal(size=3)
    steps = np.radians(model.bias_walk) / math.sqrt(model.rate_hz) * rng.normal(size=true.shape)
    noise = np.radians(model.noise) * math.sqrt(model.rate_hz) * rng.normal(size=true.shape)
    readings = (true @ model.rotation) * scale + bias + np.cumsum(steps, axis=0) + noise
    if model.range > 0:
        readings = np.clip(readings, -np.radians(model.range), np.radians(model.range))
    return readings, bias


def _generator(seed: int, part: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(f"imu {part}".encode())])


def _transform(transform: NDArray[np.float64], points: Array) -> Array:
    return np.asarray(points @ transform[:3, :3].T + transform[:3, 3])
