"""What a fit is worth: the sign of v, residuals, covariance, contrast gain and status."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from emoflow_ros.core.epipolar import cheirality
from emoflow_ros.core.estimate import Status
from emoflow_ros.core.implicit import losses
from emoflow_ros.core.implicit.config import ImplicitConfig
from emoflow_ros.core.implicit.fit import Fit, Problem
from emoflow_ros.core.implicit.residuals import epipolar_residuals, rotation_residuals
from emoflow_ros.core.implicit.warp import warp
from emoflow_ros.core.spline import basis

Array = NDArray[np.float64]

# Flow errors of the network go together over about this distance.
_CORRELATION_PX = 48


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
