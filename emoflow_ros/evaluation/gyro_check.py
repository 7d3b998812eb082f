"""A gyro against the motion that the events show, for the choice of the gyro's parameters.

The alignment of the two is a rotation, a scale, a bias and a time offset.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.gyro.checks import AXES, axis_names
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.measurement import GyroMeans
from emoflow_ros.core.gyro.settings import GYRO
from emoflow_ros.evaluation.recording_options import GyroInput
from emoflow_ros.evaluation.window_results import WindowResult

Array = NDArray[np.float64]
Times = NDArray[np.int64]
_COARSE_NS = 8_000_000
_FINE_NS = 500_000
_REACH_NS = 500_000_000
_MOST_WINDOWS = 0.6
_REPEATED = 3  # windows that overlap and together count as one
_NOISE = np.radians(1.0)  # rad/s, of the events' estimates
# What is usual for gyros.
_USUAL_BIAS = np.radians(5.0)  # rad/s
_USUAL_LOG_SCALE = 0.2
_USUAL_OFFSET_NS = 100_000_000
_RAD_PER_DEG = np.pi / 180
_ROUNDS = 8
_INLIER = 3.0  # robust standard deviations beyond which a window counts less
_FEW = 8
_SLOW = math.radians(3.0)  # rad/s, spread of the motion below which an axis cannot be found
# Of the motion's variance, by medians: an unrelated gyro explains up to a half of a short one.
_LEAST_EXPLAINED = 0.7
_DEG_PER_RAD = math.degrees(1.0)


@dataclass(frozen=True)
class Alignment:
    """events = rotation @ (gyro - bias) / scale, with the gyro read `offset_ns` earlier.

    Attributes:
        rotation: (3, 3) from the gyro's axes to the optical frame.
        scale: of the gyro; 1 where its units are right.
        bias: (3,) of the gyro in its own axes and units.
        offset_ns: what is to be added to the gyro's stamps.
        residual: root mean square of the differences, outliers counting less, rad/s per axis.
        spread: (3,) root of the eigenvalues of the events' covariance over the windows, largest
            first, rad/s: how far the camera rotated about its three main axes.
        windows: how many were compared.
    """

    rotation: Array
    scale: float
    bias: Array
    offset_ns: int
    residual: float
    spread: Array
    windows: int


def align(means: GyroMeans, starts: Times, ends: Times, events: Array) -> Alignment | None:
    """Find the alignment that fits best, from half a second early to half a second late.

    Args:
        means: of the gyro.
        starts, ends: (M,) int64 ns, intervals.
        events: (M, 3) rad/s, angular velocity of the events over each.

    Returns:
        None where fewer than 8 intervals, or 60 % of them, can be compared.
    """
    best: Alignment | None = None
    for step, reach in ((_COARSE_NS, _REACH_NS), (_FINE_NS, 2 * _COARSE_NS)):
        centre = best.offset_ns if best else 0
        for shift in range(-reach, reach + 1, step):
            found = fit(means.over(starts - centre - shift, ends - centre - shift), events)
            # An offset that leaves only few windows to compare would always fit them well.
            if found is None or found.windows < _MOST_WINDOWS * len(starts):
                continue
            found = replace(found, offset_ns=centre + shift)
            if best is None or _misfit(found) < _misfit(best):
                best = found
    return best


def fit(gyro: Array, events: Array) -> Alignment | None:
    """Fit rotation, scale and bias to pairs (M, 3) robustly; None with fewer than 8 pairs."""
    known = np.isfinite(gyro).all(axis=1) & np.isfinite(events).all(axis=1)
    gyro, events = gyro[known], events[known]
    if len(gyro) < 8:
        return None
    weights = np.ones(len(gyro))
    for _ in range(_ROUNDS):
        rotation, scale, bias, left = _weighted_fit(gyro, events, weights)
        spread = 1.4826 * float(np.median(np.linalg.norm(left, axis=1))) / np.sqrt(3) + 1e-9
        weights = 1 / (1 + (left**2).sum(axis=1) / (_INLIER * spread) ** 2) ** 2
    centred = events - np.median(events, axis=0)
    eigenvalues = np.linalg.eigvalsh(np.cov(centred.T, aweights=weights))[::-1]
    rotated = np.sqrt(np.maximum(eigenvalues, 0))
    residual = float(np.sqrt((weights @ (left**2).sum(axis=1)) / weights.sum() / 3))
    return Alignment(rotation, scale, bias, 0, residual, rotated, len(gyro))


def nearest_axes(rotation: Array) -> Array:
    """Return the rotation by right angles (3, 3) that is nearest."""
    candidates = [c for c in AXES if np.linalg.det(c) > 0]
    return max(candidates, key=lambda c: float((c * rotation).sum()))


def mirrored_axes(gyro: Array, events: Array, rotation: Array) -> Array | None:
    """Return mirrored axes (3, 3) if they explain pairs (M, 3) much better than a rotation does.

    A driver that swaps two axes, or the sign of one, leaves axes that no mounting can make.
    """
    known = np.isfinite(gyro).all(axis=1) & np.isfinite(events).all(axis=1)
    gyro = gyro[known] - np.median(gyro[known], axis=0)
    events = events[known] - np.median(events[known], axis=0)

    def left(matrix: Array) -> float:
        rotated = gyro @ matrix.T
        scale = (rotated * events).sum() / max((rotated**2).sum(), 1e-12)
        return float(np.median(np.linalg.norm(events - max(scale, 0) * rotated, axis=1)))

    best = min((c for c in AXES if np.linalg.det(c) < 0), key=left)
    return best if left(best) < 0.6 * left(rotation) else None


def _weighted_fit(gyro: Array, events: Array, weights: Array) -> tuple[Array, float, Array, Array]:
    share = weights / weights.sum()
    mean_gyro, mean_events = share @ gyro, share @ events
    from_gyro, from_events = gyro - mean_gyro, events - mean_events
    cross = (share[:, None] * from_events).T @ from_gyro
    u, singular, vt = np.linalg.svd(cross)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * signs) @ vt
    power = float(share @ (from_gyro**2).sum(axis=1))
    gain = max(float(singular @ signs) / max(power, 1e-18), 1e-9)
    scale = 1 / gain
    bias = mean_gyro - scale * rotation.T @ mean_events
    left = events - gain * (gyro - bias) @ rotation.T
    return rotation, scale, bias, left


def _misfit(found: Alignment) -> float:
    """Minus the logarithm of the probability of the residual and of the gyro's parameters.

    The parameters count, since unlikely ones may fit a short recording best.
    """
    of_data = 3 * found.windows / _REPEATED * np.log(found.residual**2 + _NOISE**2) / 2
    units = (1.0, _RAD_PER_DEG, 1 / _RAD_PER_DEG)
    log_scale = min(abs(np.log(found.scale * unit)) for unit in units)
    of_gyro = (
        float(found.bias @ found.bias) / (found.scale * _USUAL_BIAS) ** 2
        + (log_scale / _USUAL_LOG_SCALE) ** 2
        + (found.offset_ns / _USUAL_OFFSET_NS) ** 2
    )
    return float(of_data + of_gyro / 2)


def check_lines(
    windows: Sequence[WindowResult], gyro: GyroInput, config: GyroConfig
) -> Iterator[str]:
    """Yield the lines of the report.

    Args:
        windows: results without the gyro.
        gyro: the one to check.
        config: its present parameters.
    """
    yield f"IMU against events: {gyro.description}"
    used = [window for window in windows if window.ok]
    starts, ends, events = _intervals(used)
    means = GyroMeans(gyro.imu.t, gyro.imu.angular)
    found = align(means, starts, ends, events) if len(used) >= _FEW else None
    if found is None:
        yield f"  cannot tell: fewer than {_FEW} windows with an estimate and readings"
        return
    rotated = ", ".join(f"{math.degrees(s):.1f}" for s in found.spread)
    yield f"  {found.windows} windows, rotation about the three main axes {rotated} deg/s (RMS)"
    if found.spread[1] < _SLOW:
        yield "  cannot tell: the camera rotates about less than two axes; use all three"
        return
    shifted = means.over(starts - found.offset_ns, ends - found.offset_ns)
    mirrored = mirrored_axes(shifted, events, found.rotation)
    if mirrored is not None:
        yield _mirror_line(mirrored)
    gain = found.rotation / found.scale
    fitted = _left(events - (shifted - found.bias) @ gain.T)
    moving = _left(events - np.median(events, axis=0))
    explained = 1 - (fitted / moving) ** 2
    if not explained >= _LEAST_EXPLAINED:
        yield (
            f"  nothing fits: the best rotation, scale, bias and time offset explain "
            f"{max(0, explained):.0%} of the events' rotation, and have to explain "
            f"{_LEAST_EXPLAINED:.0%}; {_degrees(fitted)} of {_degrees(moving)} deg/s (median) are "
            "left; is it this camera's IMU, on the same clock?"
        )
        return
    yield from _describe(found)
    offset = config.time_offset_ns
    present = _left(events - means.over(starts - offset, ends - offset) @ config.matrix().T)
    yield (
        f"  left between the two: {_degrees(fitted)} deg/s (median) with these values, which "
        f"explain {explained:.0%} of the rotation, "
        f"{_degrees(present)} deg/s with the present parameters"
    )
    angles = Rotation.from_matrix(found.rotation).as_euler("xyz", degrees=True)
    rotation = ",".join(f"{angle + 0.0:.1f}" for angle in np.round(angles, 1))
    yield (
        f"  parameters: imu.rotation={rotation} imu.time_offset_ms={found.offset_ns / 1e6:.1f} "
        f"imu.bias_deg_s={max(0.5, np.abs(np.degrees(found.bias)).max()):.1f}"
    )


def _mirror_line(mirrored: Array) -> str:
    return (
        f"  axes: ({axis_names(mirrored)}) of the IMU fit best as the camera's (x, y, z); that is "
        "a mirror, no rotation: one axis of the driver has the wrong sign, or two are swapped; no "
        "parameters can mend it"
    )


def _describe(found: Alignment) -> Iterator[str]:
    axes = nearest_axes(found.rotation)
    apart = Rotation.from_matrix(found.rotation @ axes.T).magnitude()
    yield (
        f"  rotation: the camera's (x, y, z) are ({axis_names(axes)}) of the IMU, and "
        f"{math.degrees(apart):.1f} deg from there"
    )
    yield f"  scale: the gyro shows {found.scale:.3g} times what the events show{_units(found)}"
    bias = ", ".join(f"{math.degrees(b):.2f}" for b in found.bias)
    yield f"  bias: ({bias}) deg/s in the IMU's axes"
    yield f"  time offset: {found.offset_ns / 1e6:.1f} ms, to be added to the IMU's stamps"


def _units(found: Alignment) -> str:
    if abs(found.scale / _DEG_PER_RAD - 1) < GYRO.units:
        return ": its unit is deg/s and has to be rad/s"
    if abs(found.scale * _DEG_PER_RAD - 1) < GYRO.units:
        return ": it was converted to rad/s twice"
    return ""


def _intervals(
    windows: Sequence[WindowResult],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Middle thirds of the windows, and the angular velocity, which holds there."""
    start = np.array([window.t_start for window in windows], np.int64)
    end = np.array([window.t_end for window in windows], np.int64)
    third = (end - start) // 3
    angular = np.array([window.angular for window in windows]).reshape(-1, 3)
    return start + third, end - third, angular


def _left(differences: Array) -> float:
    """Median length of differences (M, 3), those that are known; NaN without any."""
    known = differences[np.isfinite(differences).all(axis=1)]
    return float(np.median(np.linalg.norm(known, axis=1))) if len(known) else math.nan


def _degrees(value: float) -> str:
    return "-" if math.isnan(value) else f"{math.degrees(value):.2f}"
