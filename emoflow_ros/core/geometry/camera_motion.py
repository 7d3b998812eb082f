"""Motion of a calibrated camera: its spline over a window, motion field and epipolar constraint.

With bearings X = (x, y, 1) on the undistorted normalised plane and flow U in 1/s there, a
static scene at depth Z moves as U = A v / Z + B w (Heeger and Jepson, IJCV 1992). The
differential epipolar constraint (DEC) eliminates Z: what is left of U after rotation is parallel
to A v. The motion over a window is told as one segment of a uniform cubic B-spline.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from emoflow_ros.core.geometry.camera import Camera

Array = NDArray[np.float64]

CONTROL_POINTS = 4
GREVILLE = np.arange(CONTROL_POINTS) - 1.0  # control points there make a spline a straight line


def motion_matrices(bearings: Array) -> tuple[Array, Array]:
    """Build the matrices of the motion field U = A v / Z + B w.

    Args:
        bearings: (..., 2) undistorted normalised coordinates.

    Returns:
        A and B, (..., 2, 3) each.
    """
    x, y = bearings[..., 0], bearings[..., 1]
    a, b = np.zeros((2, *x.shape, 2, 3))
    a[..., 0, 0] = a[..., 1, 1] = -1.0
    a[..., 2] = bearings
    b[..., 0, 0], b[..., 0, 1], b[..., 0, 2] = x * y, -(1 + x * x), y
    b[..., 1, 0], b[..., 1, 1], b[..., 1, 2] = 1 + y * y, -x * y, -x
    return a, b


def motion_field(camera: Camera, points: Array) -> tuple[Array, Array]:
    """Matrices A and B (..., 2, 3) of the motion field in px at points (..., 2) px.

    Where the lens has no inverse they are those of the image's middle.
    """
    bearings, jacobian = camera.undistort(points)
    known = np.isfinite(bearings).all(axis=-1)
    bearings = np.where(known[..., None], bearings, 0.0)
    jacobian = np.where(known[..., None, None], jacobian, np.eye(2) / camera.fx)
    a, b = motion_matrices(bearings)
    lens = np.linalg.inv(jacobian)
    return lens @ a, lens @ b


def dec_residual(bearings: Array, flow: Array, v: Array, w: Array) -> Array:
    """Evaluate the DEC, e = U^T [v]x X - X^T S X with S = ([v]x[w]x + [w]x[v]x) / 2.

    Args:
        bearings: (N, 2).
        flow: (N, 2) in 1/s on the normalised plane.
        v: (3,) linear velocity, any scale; or (N, 3), one for each bearing.
        w: (3,) or (N, 3) angular velocity, rad/s.

    Returns:
        (N,) residuals. They vanish for the motion field of every depth and change their
        sign with v.
    """
    a, b = motion_matrices(bearings)
    translational = flow - _apply(b, w)
    epipolar = _apply(a, v)
    return translational[:, 1] * epipolar[:, 0] - translational[:, 0] * epipolar[:, 1]


def cheirality(bearings: Array, flow: Array, v: Array, w: Array, weights: Array) -> float:
    """Decide the sign of v that DEC leaves open, by positive depth.

    Of +v and -v, the scene lies in front of the camera under the one with which more of
    the translational flow U - B w agrees with A v.

    Args:
        bearings, flow: (N, 2) as in `dec_residual`.
        v, w: (3,) or (N, 3).
        weights: (N,) evidence of each sample.

    Returns:
        Agreement in [-1, 1]: its sign is the sign of v, its size the share of the
        translational flow that agrees minus the share that contradicts.
    """
    a, b = motion_matrices(bearings)
    line = _apply(a, v)
    along = ((flow - _apply(b, w)) * line).sum(axis=-1)
    along /= np.sqrt((line**2).sum(axis=-1)) + 1e-12
    total = weights @ np.abs(along)
    return float(weights @ along / total) if total > 0 else 0.0


def _apply(matrix: Array, vector: Array) -> Array:
    """Multiply (N, 2, 3) by (3,) or (N, 3)."""
    product: Array = (matrix @ vector[..., None])[..., 0]
    return product


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


def straight(ends: Array) -> Array:
    """Control points (4, 3) of a spline that goes straight between two ends (2, 3)."""
    return np.asarray(np.stack([1 - GREVILLE, GREVILLE], axis=1) @ ends)


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
