"""Egomotion over a window: one segment of a uniform cubic B-spline (method.md, section 2)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

CONTROL_POINTS = 4


def basis(s: ArrayLike) -> NDArray[np.float64]:
    """Evaluate the uniform cubic B-spline basis.

    Args:
        s: (...) position in the segment, 0 at its start and 1 at its end.

    Returns:
        (..., 4) weights of the control points; they sum to 1.
    """
    s = np.asarray(s, np.float64)
    return (
        np.stack(
            [
                (1 - s) ** 3,
                3 * s**3 - 6 * s**2 + 4,
                -3 * s**3 + 3 * s**2 + 3 * s + 1,
                s**3,
            ],
            axis=-1,
        )
        / 6
    )


@dataclass(frozen=True)
class SplineMotion:
    """Angular velocity and direction of the linear velocity over one window.

    Attributes:
        t_start, t_end: the window, ns.
        angular_points: (4, 3) control points, rad/s.
        linear_points: (4, 3) control points, without a scale; zeros if not observable.
    """

    t_start: int
    t_end: int
    angular_points: NDArray[np.float64]
    linear_points: NDArray[np.float64]

    def _basis(self, t: int) -> NDArray[np.float64]:
        return basis((t - self.t_start) / (self.t_end - self.t_start))

    def angular(self, t: int) -> NDArray[np.float64]:
        """Angular velocity at time t (ns), (3,) rad/s."""
        return self._basis(t) @ self.angular_points

    def linear(self, t: int) -> NDArray[np.float64]:
        """Direction of the linear velocity at time t (ns), (3,) unit, or zeros."""
        v = self._basis(t) @ self.linear_points
        norm = np.linalg.norm(v)
        return v / norm if norm > 0 else np.zeros(3)
