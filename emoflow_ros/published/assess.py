"""What a fit is worth: the sign of v, residuals, covariance, contrast gain and status.

A residual has the unit of flow on the normalised plane, 1/s, and the noise of the flow itself, as
in core.lattice.egomotion.
"""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera_motion import basis, cheirality, motion_matrices
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.published import losses
from emoflow_ros.published.field import warp
from emoflow_ros.published.fit import Fit, Problem
from emoflow_ros.published.implicit_config import ImplicitConfig

Array = NDArray[np.float64]

# Flow errors of the network go together over about this distance.
_CORRELATION_PX = 48

# The median of absolute values times this is the deviation of a normal distribution.
_MEDIAN_TO_SIGMA = 1.4826
_INLIER_SCALES = 3.0
# Norm of the epipolar line below which, close to the focus of expansion, the flow's noise decides
# where the line points: such samples tell less of the direction.
_SOFT = 0.1


@dataclass(frozen=True)
class Assessment:
    """Judgement of a fit; see `estimate.Quality` for the figures.

    Attributes:
        status: OK, NO_MOTION or DIVERGED.
        angular_points: (4, 3) control points, rad/s.
        linear_points: (4, 3) control points with the sign of positive depth; zeros for a
            pure rotation.
        covariance: (6, 6) of (linear, angular), see Estimate.
    """

    status: Status
    angular_points: Array
    linear_points: Array
    covariance: Array
    contrast_gain: float
    residual_px: float
    inlier_fraction: float


@torch.no_grad()
def assess(problem: Problem, result: Fit, focal: float, config: ImplicitConfig) -> Assessment:
    """Judge a fit by the flow at the window's events.

    Args:
        problem: the window that was fitted.
        result: the fit.
        focal: mean focal length, px.
        config: the configuration of the fit.
    """
    bearings, flow, basis_weights = _samples(problem, result)
    angular = result.motion.angular_points.double().cpu().numpy()
    linear = result.motion.linear_points.double().cpu().numpy()
    w = basis_weights @ angular
    rotation = config.loss.geometry == "rotation"
    if rotation:
        linear = np.zeros_like(linear)
        residuals = rotation_residuals(bearings, flow, w)
    else:
        v = basis_weights @ linear
        linear = linear * _sign(bearings, flow, v, w)
        residuals = epipolar_residuals(bearings, flow, v, w)
    gain = _contrast_gain(problem, result, config)
    status = _status(gain, residuals.scale, config)
    covariance = np.zeros((6, 6))
    if status is Status.OK:
        covariance = residuals.covariance(_patches(problem) / len(bearings))
    if rotation:
        covariance[0, 0] = -1.0
    return Assessment(
        status=status,
        angular_points=angular,
        linear_points=linear,
        covariance=covariance,
        contrast_gain=gain,
        residual_px=residuals.scale * focal * problem.duration,
        inlier_fraction=float(np.mean(residuals.inliers)),
    )


def _status(gain: float, scale: float, config: ImplicitConfig) -> Status:
    if not np.isfinite([gain, scale]).all():
        return Status.DIVERGED
    return Status.OK if gain >= config.min_contrast_gain else Status.NO_MOTION


def _samples(problem: Problem, result: Fit) -> tuple[Array, Array, Array]:
    """Evaluate bearings (N, 2), flow (N, 2) in 1/s and spline basis (N, 4) at the events."""
    pixels = problem.x.long()
    flow = result.field(problem.t, problem.x)
    bearings, flow = problem.maps.normalised(pixels, flow)
    seen = problem.maps.valid[pixels[:, 1], pixels[:, 0]]
    position = (problem.t[seen] / problem.duration).double().cpu().numpy()
    return (
        bearings[seen].double().cpu().numpy(),
        flow[seen].double().cpu().numpy(),
        basis(position),
    )


def _sign(bearings: Array, flow: Array, v: Array, w: Array) -> float:
    agreement = cheirality(bearings, flow, v, w, np.ones(len(bearings)))
    return -1.0 if agreement < 0 else 1.0


def _patches(problem: Problem) -> int:
    """Count the patches of the image that hold events, each with a flow error of its own."""
    patches = (problem.x // _CORRELATION_PX).long()
    return len(patches.unique(dim=0))


def _contrast_gain(problem: Problem, result: Fit, config: ImplicitConfig) -> float:
    """Variance of the image warped to the window's middle over that of the unwarped one.

    Both are blurred, so that the votes' own smoothing does not count against the warp.
    """
    middle = torch.full_like(problem.t[0], problem.duration / 2)
    warped = warp(result.field, problem.t, problem.x, middle, config.warp)
    height, width = problem.maps.valid.shape
    after, before = (
        losses.contrast(losses.blur(losses.vote(points, height, width)), "variance").item()
        for points in (warped, problem.x)
    )
    return after / before


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
        variance = self.scale**2 * np.count_nonzero(self.inliers) / left_over
        covariance: Array = variance * np.linalg.inv(normal) + np.outer(step, step)
        return self.freedom @ covariance @ self.freedom.T


def epipolar_residuals(bearings: Array, flow: Array, v: Array, w: Array) -> Residuals:
    """Measure how far the flow lies off the epipolar lines, which it may follow at any depth.

    Args:
        bearings: (N, 2) on the undistorted normalised plane.
        flow: (N, 2) there, 1/s.
        v: (N, 3) linear velocity of any scale; its direction is what is free to change.
        w: (N, 3) angular velocity, rad/s.

    Raises:
        numpy.linalg.LinAlgError: v has no direction, or there is no residual.
    """
    speed = np.linalg.norm(v, axis=-1, keepdims=True)
    if not len(v) or not (speed > 0).all():
        raise np.linalg.LinAlgError("the motion has no direction")
    a, b = motion_matrices(bearings)
    v = v / speed
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
