"""What ground truth offers, whatever file it comes from."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


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
