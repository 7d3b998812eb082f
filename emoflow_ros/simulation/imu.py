"""A simulated IMU: the true motion with noise, bias, scale, range, mounting and time offset."""

import math
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.options import option
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S
from emoflow_ros.simulation.truth import GroundTruth

Array = NDArray[np.float64]

GRAVITY = np.array([0.0, 9.81, 0.0])  # m/s^2; the world's y axis points down


@dataclass(frozen=True)
class ImuModel:
    """What a simulated IMU does to the true motion; the default is a usual consumer IMU.

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
        "what its stamps lack of the events' time, ms, as imu.time_offset_ms",
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


# Noise, bias and scale of nothing, and no limit: the true motion.
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
    """What the IMU says.

    Attributes:
        stamps: (N,) int64 ns, of the IMU's own clock.
        angular: (N, 3) rad/s in its own axes.
        force: (N, 3) m/s^2, specific force, in its own axes.
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

    Its errors are drawn from a generator of their own: events know nothing of the IMU.
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
