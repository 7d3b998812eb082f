"""What a gyro says: its readings, and whether it takes part in an estimate.

Readings are on the events' clock and in the camera's optical frame.
"""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

REACH_NS = 30_000_000  # further from a reading the angular velocity is not known


@dataclass(frozen=True)
class GyroReadings:
    """Angular velocities as a gyro measures them: with its bias, and perhaps not finite.

    Attributes:
        t: (N,) int64 ns on the events' clock, increasing.
        w: (N, 3) rad/s in the camera's optical frame.
    """

    t: NDArray[np.int64]
    w: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.t)

    @classmethod
    def mounted(
        cls,
        t: NDArray[np.int64],
        w: NDArray[np.float64],
        rotation: NDArray[np.float64],
        offset_ns: int = 0,
    ) -> "GyroReadings":
        """Bring readings into the camera's frame and onto its clock.

        A reading that is no later than one before it is left out.

        Args:
            t: (N,) int64 ns, stamps of the gyro.
            w: (N, 3) rad/s in the gyro's axes.
            rotation: (3, 3) from the gyro's axes to the optical frame.
            offset_ns: that is added to the stamps.
        """
        later = np.ones(len(t), np.bool_)
        later[1:] = t[1:] > np.maximum.accumulate(t)[:-1]
        kept = w[later]
        # Not a matrix product, whose rounding depends on how many readings there are.
        turned = sum(kept[:, k, None] * rotation[None, :, k] for k in range(3))
        return cls(t[later] + offset_ns, np.asarray(turned, np.float64))

    def covering(self, t_start: int, t_end: int, reach_ns: int = REACH_NS) -> "GyroReadings":
        """Return the readings of an interval (ns) and the next one on either side.

        Those beside it are left out if they are further from it than `reach_ns`.
        """
        first = max(0, int(np.searchsorted(self.t, t_start, "right")) - 1)
        last = int(np.searchsorted(self.t, t_end)) + 1
        near = self.t[first:last]
        inside = (near >= t_start - reach_ns) & (near <= t_end + reach_ns)
        return GyroReadings(near[inside], self.w[first:last][inside])


class GyroFault(StrEnum):
    """Why readings cannot be used."""

    SILENT = "no readings"
    LATE = "readings end before the window"
    GAP = "a gap in the readings' time"
    NOT_FINITE = "readings that are not finite"
    SATURATED = "readings at the end of the range"
    FROZEN = "readings that do not change"
    DISAGREES = "gyro and events disagree"


class GyroState(StrEnum):
    """Whether the gyro took part in an estimate."""

    USED = "used"
    NONE = "none"
    REJECTED = "rejected"


@dataclass(frozen=True)
class KnownBias:
    """What is known of a gyro's bias.

    Attributes:
        mean: (3,) rad/s, which the gyro's angular velocities are without.
        covariance: (3, 3) of it, which is in theirs.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class GyroStatus:
    """The state of the gyro, why it is not used, and its bias where it is."""

    state: GyroState = GyroState.NONE
    reason: str = ""
    bias: KnownBias | None = field(default=None, compare=False)

    def __str__(self) -> str:
        """For example `rejected (no readings)`."""
        return f"{self.state} ({self.reason})" if self.reason else str(self.state)


@dataclass(frozen=True)
class SeenBias:
    """A gyro's bias as the events show it over some time, without what was known of it before.

    Attributes:
        excess: (3,) rad/s, over the bias that was known in the newest window.
        covariance: (3, 3) of it.
        seconds: of that time: what is seen nearer in time shares its errors.
    """

    excess: NDArray[np.float64]
    covariance: NDArray[np.float64]
    seconds: float
