"""What a fit is worth: the sign of v, residuals, contrast gain and status."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from emoflow_ros.core.epipolar import cheirality, dec_residual, motion_matrices
from emoflow_ros.core.estimate import Status
from emoflow_ros.core.implicit import losses
from emoflow_ros.core.implicit.config import ImplicitConfig
from emoflow_ros.core.implicit.fit import Fit, Problem
from emoflow_ros.core.implicit.warp import warp
from emoflow_ros.core.spline import basis

Array = NDArray[np.float64]

# The median of absolute values times this is the deviation of a normal distribution.
_MEDIAN_TO_SIGMA = 1.4826
_INLIER_SCALES = 3.0


@dataclass(frozen=True)
class Assessment:
    """Judgement of a fit; see `estimate.Quality` for the figures.

    Attributes:
        status: OK, NO_MOTION or DIVERGED.
        angular_points: (4, 3) control points, rad/s.
        linear_points: (4, 3) control points with the sign of positive depth; zeros for a
            pure rotation.
    """

    status: Status
    angular_points: Array
    linear_points: Array
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
    if config.loss.geometry == "rotation":
        linear = np.zeros_like(linear)
        residual = _rotation_residual(bearings, flow, w)
    else:
        v = basis_weights @ linear
        linear = linear * _sign(bearings, flow, v, w)
        residual = _epipolar_residual(bearings, flow, v, w)
    residual = np.abs(residual) * focal * problem.duration
    scale = float(_MEDIAN_TO_SIGMA * np.median(residual))
    gain = _contrast_gain(problem, result, config)
    return Assessment(
        status=_status(gain, scale, config),
        angular_points=angular,
        linear_points=linear,
        contrast_gain=gain,
        residual_px=scale,
        inlier_fraction=float(np.mean(residual <= _INLIER_SCALES * scale)),
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


def _epipolar_residual(bearings: Array, flow: Array, v: Array, w: Array) -> Array:
    """Distance (N,) of the flow from what the motion allows at any depth, 1/s."""
    a, _ = motion_matrices(bearings)
    line = np.linalg.norm(np.einsum("nij,nj->ni", a, v), axis=-1)
    return dec_residual(bearings, flow, v, w) / np.maximum(line, 1e-12)


def _rotation_residual(bearings: Array, flow: Array, w: Array) -> Array:
    """Both components (2 N,) of the flow that the rotation leaves over, 1/s."""
    _, b = motion_matrices(bearings)
    return (flow - np.einsum("nij,nj->ni", b, w)).ravel()


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
