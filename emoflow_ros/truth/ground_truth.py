"""What ground truth offers, whatever its file format, and the velocity that poses give."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.errors import InputError

# The filter: a cubic polynomial fitted to the poses within this time of the query. Third order
# keeps the bias of a 1 Hz oscillation below 2 %. MVSEC's own smoothing (SmoothedOdometry) leaves a
# quarter of the oscillation.
HALF_WIDTH_S = 0.15
_ORDER = 3
_NO_ROTATION = 1e-6
TAKEN_AS_CAMERA = "taken as those of the event camera's optical frame"


@dataclass(frozen=True)
class TrueTwist:
    """The camera's velocity at one time, in its optical frame.

    Attributes:
        angular: (3,) rad/s.
        linear: (3,) m/s; None where the source says nothing about translation.
    """

    angular: NDArray[np.float64]
    linear: NDArray[np.float64] | None


@dataclass(frozen=True)
class TrueFlow:
    """The true displacement of the pixels over an interval.

    Attributes:
        displacement: (H, W, 2) px, u right and v down; zero where not valid.
        valid: (H, W), where the truth is known.
        moving: (H, W), what sees an object that moves by itself; None where that is unknown.
        everywhere: whether all valid pixels are compared, as DSEC's benchmark does, instead of
            those that hold events and have |u| > 0 and |v| > 0, as MVSEC's does.
    """

    displacement: NDArray[np.float32]
    valid: NDArray[np.bool_]
    moving: NDArray[np.bool_] | None = None
    everywhere: bool = False


class TwistSource(Protocol):
    """True velocity over time.

    Attributes:
        name: where it comes from, in a word or two.
        description: how it came about, with every filter.
    """

    name: str
    description: str

    def twist(self, t: int) -> TrueTwist | None:
        """Velocity at time t (ns); None where there is no truth for it."""
        ...


class FlowSource(Protocol):
    """True displacement over intervals. `description` says how it came about."""

    description: str

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Where the pixels of time t0 are at t1 (ns); None where there is no truth."""
        ...


class PoseSource(Protocol):
    """True poses over time, in any fixed world."""

    def covers(self, t: int) -> bool:
        """Whether the pose at time t (ns) is known."""
        ...

    def transform(self, t: int) -> NDArray[np.float64]:
        """World-from-camera (4, 4) at time t (ns), which must be covered; metres."""
        ...


@dataclass(frozen=True)
class Truth:
    """Ground truth of one recording; every part may be missing.

    Attributes:
        twists: the velocity that errors are counted against.
        flows: the flow.
        other_twists: velocities from other sources, which are reported beside `twists`.
        poses: the trajectory.
    """

    twists: TwistSource | None = None
    flows: FlowSource | None = None
    other_twists: tuple[TwistSource, ...] = ()
    poses: PoseSource | None = None

    @property
    def description(self) -> list[str]:
        """One line per source, for the report."""
        sources = [s for s in (self.twists, self.flows, *self.other_twists) if s]
        return list(dict.fromkeys(source.description for source in sources))


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
