"""What a motion leaves of the flow, and the covariance of the motion that follows from it.

A residual has the unit of flow on the normalised plane, 1/s, and the noise of the flow itself, as
in core.egomotion.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.epipolar import motion_matrices

Array = NDArray[np.float64]

# The median of absolute values times this is the deviation of a normal distribution.
_MEDIAN_TO_SIGMA = 1.4826
_INLIER_SCALES = 3.0
# Norm of the epipolar line below which, close to the focus of expansion, the flow's noise decides
# where the line points: such samples tell less of the direction.
_SOFT = 0.1


@dataclass(frozen=True)
class Residuals:
    """Residuals of a motion at samples of the flow, linearised.

    Attributes:
        r: (M,) 1/s.
        by_motion: (M, 6) their derivatives by a change of (v, w), the same at all samples.
        freedom: (6, P) orthonormal changes of (v, w) that the residuals may tell.
    """

    r: Array
    by_motion: Array
    freedom: Array

    @property
    def scale(self) -> float:
        """Robust standard deviation, 1/s."""
        return float(_MEDIAN_TO_SIGMA * np.median(np.abs(self.r)))

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """Which residuals (M,) lie within 3 robust standard deviations."""
        return np.asarray(np.abs(self.r) <= _INLIER_SCALES * self.scale)

    def covariance(self, share: float) -> Array:
        """Estimate the covariance of (v, w) by the Gauss-Newton normal equations of the inliers.

        It is scaled by the residuals' robust variance. An iterative fit may have stopped short of
        the minimum: the Gauss-Newton step that is left counts as one more error.

        Args:
            share: of the residuals, as many as have errors of their own; errors of neighbours in
                a smooth flow go together.

        Returns:
            (6, 6), zero where the motion has no freedom.
        """
        rows = self.by_motion[self.inliers] @ self.freedom
        normal = rows.T @ rows
        normal += 1e-12 * np.trace(normal) * np.eye(len(normal))  # what nothing tells is unknown
        step = np.linalg.solve(normal, rows.T @ self.r[self.inliers])
        left_over = max(1.0, share * len(self.r) - len(normal))
        variance = self.scale**2 * len(self.r) / left_over
        covariance: Array = variance * np.linalg.inv(normal) + np.outer(step, step)
        return self.freedom @ covariance @ self.freedom.T


def epipolar_residuals(bearings: Array, flow: Array, v: Array, w: Array) -> Residuals:
    """Measure how far the flow lies off the epipolar lines, which it may follow at any depth.

    Args:
        bearings: (N, 2) on the undistorted normalised plane.
        flow: (N, 2) there, 1/s.
        v: (N, 3) linear velocity of any scale; its direction is what is free to change.
        w: (N, 3) angular velocity, rad/s.
    """
    a, b = motion_matrices(bearings)
    v = v / np.linalg.norm(v, axis=-1, keepdims=True)
    line = np.einsum("nij,nj->ni", a, v)
    norm = np.linalg.norm(line, axis=-1, keepdims=True)
    normal = np.stack([-line[:, 1], line[:, 0]], axis=-1) / np.maximum(norm, 1e-12)
    translational = flow - np.einsum("nij,nj->ni", b, w)
    # A line that turns moves off the flow by its angle times the flow along it.
    along = (line * translational).sum(axis=-1, keepdims=True) / (norm**2 + _SOFT**2)
    by_v = np.einsum("ni,nij->nj", -along * normal, a)
    by_w = np.einsum("ni,nij->nj", -normal, b)
    freedom = np.zeros((6, 5))
    freedom[:3, :2] = np.linalg.svd(v.mean(axis=0)[None])[2][1:].T
    freedom[3:, 2:] = np.eye(3)
    return Residuals((normal * translational).sum(axis=-1), np.hstack([by_v, by_w]), freedom)


def rotation_residuals(bearings: Array, flow: Array, w: Array) -> Residuals:
    """Take both components of the flow that a pure rotation w (N, 3) leaves over: (2 N,)."""
    _, b = motion_matrices(bearings)
    left = flow - np.einsum("nij,nj->ni", b, w)
    by_w = -b.reshape(-1, 3)
    freedom = np.vstack([np.zeros((3, 3)), np.eye(3)])
    return Residuals(left.ravel(), np.hstack([np.zeros_like(by_w), by_w]), freedom)
