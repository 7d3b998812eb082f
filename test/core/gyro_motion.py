"""Readings of a gyro, and estimates of the events, of a motion in closed form."""

import numpy as np

from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.types.gyro import GyroReadings

MS = 1_000_000
S = 1_000_000_000
WINDOW, STRIDE = 135 * MS, 45 * MS
START = 1_500_000_000 * S
CONFIG = GyroConfig(use="auto")
PERFECT = GyroConfig(use="auto", scale_error=0.0, rotation_error_deg=0.0, bias_deg_s=0.0)


def readings(w, seconds=1.0, rate=1000, start=START):
    """Readings of w(seconds) from a little before the start on, of which no two are the same."""
    t = start + np.arange(-20 * MS, round(seconds * S), S // rate)
    values = np.stack([np.ones(3) * w(x) for x in (t - start) / S])
    values[::2] += 1e-12
    return GyroReadings(t.astype(np.int64), values)


def noisy(w, seed=0, density=0.01, rate=1000, **kwargs):
    found = readings(w, rate=rate, **kwargs)
    noise = np.random.default_rng(seed).normal(size=found.w.shape)
    return GyroReadings(found.t, found.w + np.radians(density) * np.sqrt(rate) * noise)


def windows(seconds, start=START):
    return [(t, t + WINDOW) for t in range(start, start + round(seconds * S) - WINDOW, STRIDE)]


def turning(x):
    """A varied motion, rad/s at x seconds."""
    return np.array([0.6 * np.sin(3.1 * x), 0.5 * np.sin(2.3 * x + 1), 0.4 * np.cos(4.7 * x)])


def follow(gyro, found, truth, seconds, *, sigma=1.0, seed=1, start=START):
    """Run windows over readings, with events that tell `truth` with `sigma` deg/s."""
    rng = np.random.default_rng(seed)
    measured = []
    for t_start, t_end in windows(seconds, start):
        measured.append(gyro.measure(t_start, t_end, found))
        middle = truth(((t_start + t_end) / 2 - start) / S)
        error = np.radians(sigma) * rng.normal(size=3)
        gyro.learn(middle + error, np.radians(sigma) ** 2 * np.eye(3))
    return measured
