"""How wide a motion may be to be given out: bounds that users set."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.types.twist import PresentTwist


@dataclass(frozen=True)
class OutputBounds:
    """Largest standard deviations along any axis; 0 sets no bound.

    Attributes:
        angular: of the angular velocity, rad/s.
        direction: of the direction of translation, rad.
    """

    angular: float = 0.0
    direction: float = 0.0

    def apply(self, found: PresentTwist) -> PresentTwist | None:
        """Return a motion without a direction that is too wide; None if w is too wide."""
        covariance, translates = found.covariance, found.covariance[0, 0] >= 0
        if self.angular and _widest(covariance[3:, 3:]) > self.angular:
            return None
        if self.direction and translates and _widest(covariance[:3, :3]) > self.direction:
            twist = replace(found.twist, linear=np.zeros(3))
            return PresentTwist(twist, without_translation(covariance))
        return found


def _widest(covariance: NDArray[np.float64]) -> float:
    """Largest standard deviation along any axis."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))
