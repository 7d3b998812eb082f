"""Gyros of the recordings: simulated from the true motion, or the recording's own."""

import zlib

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.readers.reader_base import Imu
from emoflow_ros.simulation.simulated_truth import (
    GroundTruth,
    ImuModel,
    measure_rotation,
    reading_times,
)
from emoflow_ros.truth.ground_truth import PoseTrack
from emoflow_ros.truth.text_truth import GyroTwist

# 1000 Hz, 0.01 deg/s/sqrt(Hz), a bias of 1 deg/s and a scale error of 1 % in each axis.
CONSUMER = ImuModel()


def consumer_gyro(
    t: NDArray[np.int64], true: NDArray[np.float64], name: str, model: ImuModel = CONSUMER
) -> GyroReadings:
    """Add a consumer gyro's errors to the true rotation; the same name draws the same errors.

    Args:
        t: (N,) int64 ns, at the model's rate.
        true: (N, 3) rad/s in the optical frame.
        name: of the recording.
        model: of the gyro.
    """
    readings, _ = measure_rotation(true, model, zlib.crc32(name.encode()))
    return GyroReadings.mounted(t, readings, model.rotation)


def gyro_of_simulation(truth: GroundTruth, t_start: int, t_end: int, name: str) -> GyroReadings:
    """Let a consumer gyro measure a simulated recording, [t_start, t_end] in ns."""
    t = reading_times(t_start, t_end + 1, CONSUMER.rate_hz)
    true = np.array([truth.twist(int(time))[1] for time in t])
    return consumer_gyro(t, true, name)


def gyro_of_poses(track: PoseTrack, name: str) -> GyroReadings:
    """Let a consumer gyro measure the rotation between poses.

    It is constant between two poses at their mean time, and linear from there to the next mean
    time: of poses at 200 Hz no motion below 20 Hz is lost.
    """
    middle, between = rotation_rates(track)
    first, last = int(track.stamps[0]), int(track.stamps[-1])
    t = reading_times(first, last + 1, CONSUMER.rate_hz)
    since = (t - first).astype(np.float64)
    knots = (middle - first).astype(np.float64)
    true = np.stack([np.interp(since, knots, between[:, axis]) for axis in range(3)], axis=1)
    return consumer_gyro(t, true, name)


def rotation_rates(track: PoseTrack) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Mean angular velocities (N - 1, 3), rad/s in the body's axes, between N poses.

    Returns:
        The times half way between the poses, ns, and the velocities.
    """
    rotations = Rotation.from_quat(track.quaternions)
    seconds = np.diff(track.stamps) / NS_PER_S
    rates = (rotations[:-1].inv() * rotations[1:]).as_rotvec() / seconds[:, None]
    return track.stamps[:-1] + np.diff(track.stamps) // 2, rates


def own_gyro(imu: Imu | None) -> GyroReadings | None:
    """Take a recording's own gyro, which lies in the camera's axes; None where it has none."""
    return None if imu is None else GyroReadings.mounted(imu.t, imu.angular, np.eye(3))


def without_bias(gyro: GyroReadings, rest_s: float) -> GyroTwist:
    """Take a gyro as the truth, less the mean of its readings in the first `rest_s` seconds.

    Args:
        gyro: of a camera that is at rest until then.
        rest_s: how long, s.
    """
    at_rest = gyro.t < gyro.t[0] + round(rest_s * NS_PER_S)
    rates = gyro.w - gyro.w[at_rest].mean(axis=0)
    return GyroTwist(gyro.t, rates, "gyro", f"less its mean over the first {rest_s:g} s")
