"""Velocity of the camera from its poses, by a declared filter."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.errors import InputError
from emoflow_ros.offline.truth.base import TrueTwist

# The filter: a cubic polynomial fitted to the poses within this time of the query. Third order
# keeps the bias of a 1 Hz oscillation below 2 %, where MVSEC's own smoothing (odom_npz.py) leaves
# a quarter of it.
HALF_WIDTH_S = 0.15
_ORDER = 3
_NO_ROTATION = 1e-6
TAKEN_AS_CAMERA = "taken as those of the event camera's optical frame"


@dataclass(frozen=True)
class PoseTrack:
    """Poses world-from-camera over time.

    Attributes:
        stamps: (N,) int64 ns, increasing.
        positions: (N, 3) m.
        quaternions: (N, 4) x, y, z, w.
    """

    stamps: NDArray[np.int64]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]

    def covers(self, t: int) -> bool:
        """Whether t (ns) lies between the first and the last pose."""
        return len(self.stamps) > 1 and int(self.stamps[0]) <= t <= int(self.stamps[-1])

    def transform(self, t: int) -> NDArray[np.float64]:
        """World-from-camera (4, 4) at time t (ns), interpolated; t must be covered."""
        after = int(np.clip(np.searchsorted(self.stamps, t), 1, len(self.stamps) - 1))
        pair = slice(after - 1, after + 1)
        times = self.stamps[pair] - self.stamps[after - 1]
        share = (t - self.stamps[after - 1]) / times[1]
        transform = np.eye(4)
        slerp = Slerp([0.0, 1.0], Rotation.from_quat(self.quaternions[pair]))
        transform[:3, :3] = slerp(share).as_matrix()
        transform[:3, 3] = (1 - share) * self.positions[after - 1] + share * self.positions[after]
        return transform


def pose_track(
    path: Path,
    stamps: NDArray[np.int64],
    positions: NDArray[np.float64],
    quaternions: NDArray[np.float64],
) -> PoseTrack:
    """Make a track of what a file holds; see PoseTrack for the shapes.

    Raises:
        InputError: values that are not finite, or quaternions without a length.
    """
    if not (np.isfinite(positions).all() and np.isfinite(quaternions).all()):
        raise InputError(path, "poses that are not finite", "leave them out")
    empty = np.flatnonzero(np.linalg.norm(quaternions, axis=1) < _NO_ROTATION)
    if len(empty):
        at = stamps[empty[0]] / NS_PER_S
        raise InputError(path, f"the quaternion at {at:.6f} s is zero", "leave such poses out")
    return PoseTrack(stamps, positions, quaternions)


class PoseTwist:
    """Velocity as the slope of a local cubic fit to positions and rotation vectors.

    Args:
        track: the poses.
        name: where they come from.
        note: what else to say of them in the description.
    """

    def __init__(self, track: PoseTrack, name: str, note: str = "") -> None:
        self._track = track
        self.name = name
        self.description = (
            f"velocity: {name}, slope of a cubic least-squares fit to the poses within "
            f"{HALF_WIDTH_S * 1000:.0f} ms" + (f", {note}" if note else "")
        )

    def twist(self, t: int) -> TrueTwist | None:
        """Velocity at time t (ns) in the camera's frame; None with fewer than 5 poses around."""
        track = self._track
        reach = round(HALF_WIDTH_S * NS_PER_S)
        first, last = np.searchsorted(track.stamps, [t - reach, t + reach + 1])
        if not track.covers(t) or last - first < _ORDER + 2:
            return None
        near = slice(int(first), int(last))
        seconds = (track.stamps[near] - t) / NS_PER_S
        rotations = Rotation.from_quat(track.quaternions[near])
        # Rotation vectors against the pose nearest to t, small enough to be a vector space.
        nearest = rotations[int(np.abs(seconds).argmin())]
        vectors = (nearest.inv() * rotations).as_rotvec()
        fit = np.polynomial.polynomial.polyfit(
            seconds / HALF_WIDTH_S, np.hstack([track.positions[near], vectors]), _ORDER
        )
        value, slope = fit[0], fit[1] / HALF_WIDTH_S
        rotation = nearest * Rotation.from_rotvec(value[3:])
        angular = _right_jacobian(value[3:]) @ slope[3:]
        return TrueTwist(angular=angular, linear=rotation.inv().apply(slope[:3]))


def _right_jacobian(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Body rate from the rate of a rotation vector (Sola et al., arXiv 1812.01537, eq. 143)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.eye(3) - cross / 2
    first = (1 - np.cos(angle)) / angle**2
    second = (angle - np.sin(angle)) / angle**3
    return np.eye(3) - first * cross + second * (cross @ cross)
