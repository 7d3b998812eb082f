"""How fast the camera goes, relative to earlier: by the memory of positions.

Each adjustment has lengths in mean depths of the scene that it sees. Two successive ones share
nodes, and the way over these in both says how one unit is to be read in the other.
"""

import numpy as np

from emoflow_ros.core.back_end.trajectory import AdjustedMotion, interpolated
from emoflow_ros.core.products.motion_prior import HeldMotion
from emoflow_ros.core.types.estimate import Estimate


class RelativeSpeed:
    """Follows one window after another. All speeds are up to one factor for the recording."""

    def __init__(self) -> None:
        self._last: AdjustedMotion | None = None
        self._unit = 1.0  # of the last adjustment, in that of the first one
        self._speed = float("nan")  # the last one that was known

    def follow(self, estimate: Estimate) -> float:
        """Return the speed at a window's time; NaN where no adjustment tells one.

        Where the memory began anew in between, the camera is taken to go on as fast as before.
        """
        motion = estimate.motion
        if isinstance(motion, HeldMotion):
            motion = motion.motion
        if not isinstance(motion, AdjustedMotion) or not motion.translates:
            self._last = None
            return float("nan")
        own = float(np.linalg.norm(interpolated(motion.times, motion.x, estimate.t)[1]))
        change = None if self._last is None else _change_of_unit(self._last, motion)
        if change is not None:
            self._unit *= change
        elif own > 0 and self._speed > 0:
            self._unit = self._speed / own
        self._last, self._speed = motion, self._unit * own
        return self._speed


def _change_of_unit(before: AdjustedMotion, after: AdjustedMotion) -> float | None:
    """Unit of an adjustment in that of the one before; None if they share no way."""
    _, first, second = np.intersect1d(before.times, after.times, return_indices=True)
    ways = [
        float(np.linalg.norm(np.diff(motion.x.position[nodes], axis=0), axis=1).sum())
        for motion, nodes in ((before, first), (after, second))
    ]
    return ways[0] / ways[1] if min(ways) > 0 else None
