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
    """

    displacement: NDArray[np.float32]
    valid: NDArray[np.bool_]
    moving: NDArray[np.bool_] | None = None


class TwistSource(Protocol):
    """True velocity over time. `description` says how it came about, with every filter."""

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


@dataclass(frozen=True)
class Truth:
    """Ground truth of one recording; either part may be missing."""

    twists: TwistSource | None = None
    flows: FlowSource | None = None

    @property
    def description(self) -> list[str]:
        """One line per source, for the report."""
        sources = [source for source in (self.twists, self.flows) if source]
        return list(dict.fromkeys(source.description for source in sources))
