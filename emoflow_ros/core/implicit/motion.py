"""Egomotion as spline control points that autograd optimises."""

import torch
from torch import Tensor, nn

from emoflow_ros.core.spline import CONTROL_POINTS


class MotionSpline(nn.Module):
    """Control points of the window's angular and linear velocity (core/spline.py).

    Args:
        start: what all control points start from.
    """

    def __init__(self, start: float) -> None:
        super().__init__()
        self.angular_points = nn.Parameter(torch.full((CONTROL_POINTS, 3), start))
        self.linear_points = nn.Parameter(torch.full((CONTROL_POINTS, 3), start))

    def forward(self, weights: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate the splines.

        Args:
            weights: (4,) basis at one time, from `core.spline.basis`.

        Returns:
            Linear velocity as a unit direction (3,) and angular velocity (3,) in rad/s.
        """
        linear = nn.functional.normalize(weights @ self.linear_points, dim=0)
        return linear, weights @ self.angular_points
