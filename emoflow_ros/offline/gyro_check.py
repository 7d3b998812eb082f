"""Compare a gyro with the motion that the events tell, for who has to set its parameters."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from emoflow_ros.core.gyro_axes import UNITS, axis_names
from emoflow_ros.core.gyro_config import GyroConfig
from emoflow_ros.offline.gyro_alignment import (
    Alignment,
    GyroMeans,
    align,
    mirrored_axes,
    nearest_axes,
)
from emoflow_ros.offline.gyro_input import GyroInput
from emoflow_ros.offline.results import WindowResult

Array = NDArray[np.float64]

_FEW = 8
_SLOW = math.radians(3.0)  # rad/s, spread of the motion below which an axis is not told
_DEG = math.degrees(1.0)


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
    turned = ", ".join(f"{math.degrees(s):.1f}" for s in found.spread)
    yield f"  {found.windows} windows, rotation about the three main axes {turned} deg/s (RMS)"
    if found.spread[1] < _SLOW:
        yield "  cannot tell: the camera turns about less than two axes; turn it about all three"
        return
    shifted = means.over(starts - found.offset_ns, ends - found.offset_ns)
    yield from _describe(found, shifted, events)
    gain = found.rotation / found.scale
    fitted = _left(events - (shifted - found.bias) @ gain.T)
    offset = config.time_offset_ns
    present = _left(events - means.over(starts - offset, ends - offset) @ config.matrix().T)
    yield (
        f"  left between the two: {_degrees(fitted)} deg/s (median) with these values, "
        f"{_degrees(present)} deg/s with the present parameters"
    )
    angles = Rotation.from_matrix(found.rotation).as_euler("xyz", degrees=True)
    rotation = ",".join(f"{angle + 0.0:.1f}" for angle in np.round(angles, 1))
    yield (
        f"  parameters: imu.rotation={rotation} imu.time_offset_ms={found.offset_ns / 1e6:.1f} "
        f"imu.bias_deg_s={max(0.5, np.abs(np.degrees(found.bias)).max()):.1f}"
    )


def _describe(found: Alignment, gyro: Array, events: Array) -> Iterator[str]:
    mirrored = mirrored_axes(gyro, events, found.rotation)
    axes = nearest_axes(found.rotation)
    apart = Rotation.from_matrix(found.rotation @ axes.T).magnitude()
    if mirrored is not None:
        yield (
            f"  axes: ({axis_names(mirrored)}) of the IMU fit best as the camera's (x, y, z); that "
            "is a mirror, no rotation: one axis of the driver has the wrong sign, or two are "
            "swapped; the parameters below cannot mend it"
        )
    yield (
        f"  rotation: the camera's (x, y, z) are ({axis_names(axes)}) of the IMU, and "
        f"{math.degrees(apart):.1f} deg from there"
    )
    yield f"  scale: the gyro shows {found.scale:.3g} times what the events show{_units(found)}"
    bias = ", ".join(f"{math.degrees(b):.2f}" for b in found.bias)
    yield f"  bias: ({bias}) deg/s in the IMU's axes"
    yield f"  time offset: {found.offset_ns / 1e6:.1f} ms, to be added to the IMU's stamps"


def _units(found: Alignment) -> str:
    if abs(found.scale / _DEG - 1) < UNITS:
        return ": its unit is deg/s and has to be rad/s"
    if abs(found.scale * _DEG - 1) < UNITS:
        return ": it was converted to rad/s twice"
    return ""


def _intervals(
    windows: Sequence[WindowResult],
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Middle thirds of the windows, where their angular velocity holds, and that."""
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
