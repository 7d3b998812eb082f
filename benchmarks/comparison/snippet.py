"""The truth of a short real recording whose events carry their depth, and its velocities.

The folder holds `events.txt` (`t x y p`, t in s), `calib.yaml`, `depth.txt` (one depth per event,
m) and `velocity_truth.txt` (`t_start t_end wx wy wz vx vy vz`: means over parts, rad/s and m/s, in
the camera's frame).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_matrices
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.readers.text_tables import read_table
from emoflow_ros.truth import TrueFlow, TrueTwist, Truth

EVENTS, CALIBRATION, DEPTH, VELOCITY = (
    "events.txt",
    "calib.yaml",
    "depth.txt",
    "velocity_truth.txt",
)
_STEPS = 8  # times at which the velocity is averaged over an interval


def is_snippet(folder: Path) -> bool:
    """Whether a folder holds a recording of this kind."""
    return all((folder / name).is_file() for name in (EVENTS, CALIBRATION, DEPTH, VELOCITY))


@dataclass
class _Velocity:
    """Velocity between the middles of the parts by a straight line, constant beyond them."""

    times: NDArray[np.float64]
    values: NDArray[np.float64]
    name: str = "poses"
    description: str = "velocity: means over parts of the snippet, by its poses"

    def twist(self, t: int) -> TrueTwist:
        """Velocity at time t (ns)."""
        now = self.at(t)
        return TrueTwist(now[:3], now[3:])

    def at(self, t: float) -> NDArray[np.float64]:
        """Angular and linear velocity at time t (ns), (6,)."""
        return np.array([np.interp(t / NS_PER_S, self.times, column) for column in self.values.T])


@dataclass
class _EventFlow:
    """Displacement of the pixels that hold events, by the median of these events' depths."""

    camera: Camera
    velocity: _Velocity
    events: NDArray[np.float64]
    depths: NDArray[np.float64]
    description: str = "flow: motion field of velocity and depth, at pixels with events"

    def displacement(self, t0: int, t1: int) -> TrueFlow:
        """Where the pixels of time t0 are at t1 (ns), if the flow does not change on the way."""
        depth = self._depth(t0, t1)
        times = np.linspace(t0, t1, _STEPS)
        w, v = np.mean([self.velocity.at(t) for t in times], axis=0).reshape(2, 3)
        a, b = motion_matrices(self.camera.bearings.astype(np.float64))
        known = np.isfinite(depth)
        normalised = a @ v / np.where(known, depth, 1.0)[..., None] + b @ w
        to_pixels = np.linalg.inv(self.camera.flow_jacobian)
        pixels = np.einsum("hwij,hwj->hwi", to_pixels, normalised)
        moved = np.where(known[..., None], pixels * (t1 - t0) / NS_PER_S, 0.0)
        return TrueFlow(moved.astype(np.float32), known)

    def _depth(self, t0: int, t1: int) -> NDArray[np.float64]:
        """Median depth of each pixel's events of the interval, (H, W); NaN without any."""
        t = self.events[:, 0] * NS_PER_S
        of_interval = (t0 <= t) & (t < t1)
        x, y = self.events[of_interval, 1:3].astype(np.intp).T
        depth = np.full((self.camera.height, self.camera.width), np.nan)
        by_pixel: dict[tuple[int, int], list[float]] = {}
        for row, column, z in zip(y, x, self.depths[of_interval], strict=True):
            by_pixel.setdefault((row, column), []).append(z)
        for place, values in by_pixel.items():
            depth[place] = np.median(values)
        return depth


def load_snippet(folder: Path, camera: Camera) -> Truth:
    """Read the truth of a snippet.

    Raises:
        InputError: a file is not such a table, or depths and events are not as many.
    """
    events = read_table(folder / EVENTS, 4, "t x y p")
    depths = read_table(folder / DEPTH, 1, "depth")[:, 0]
    if len(depths) != len(events):
        raise InputError(
            folder / DEPTH,
            f"{len(depths)} depths for {len(events)} events",
            "give one for each event",
        )
    rows = read_table(folder / VELOCITY, 8, "t_start t_end wx wy wz vx vy vz")
    velocity = _Velocity(rows[:, :2].mean(axis=1), rows[:, 2:])
    return Truth(velocity, _EventFlow(camera, velocity, events, depths))
