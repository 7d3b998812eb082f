"""Errors against the covariance of an estimate."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Added to variances, (1e-6)^2: a covariance of zero is an error of many sigmas, not a failure.
VARIANCE_FLOOR = 1e-12


def normalised_squares(errors: Array, covariances: Array) -> Array:
    """Square errors over covariance and degrees of freedom (NEES; Bar-Shalom et al., 2001).

    Args:
        errors: (N, D).
        covariances: (N, D, D).

    Returns:
        (N,), 1 on average for a covariance that is right; NaN where an input is, and for an error
        of exactly zero: no covariance is right for a simulated camera at rest that is told so.
    """
    dimensions = errors.shape[-1]
    known = np.isfinite(errors).all(axis=-1) & np.isfinite(covariances).all(axis=(-2, -1))
    known &= (errors != 0).any(axis=-1)
    squares = np.full(len(errors), np.nan)
    some = covariances[known] + VARIANCE_FLOOR * np.eye(dimensions)
    solved = np.linalg.solve(some, errors[known][..., None])[..., 0]
    squares[known] = (errors[known] * solved).sum(axis=-1) / dimensions
    return squares


def sigma_along(errors: Array, covariances: Array) -> Array:
    """Standard deviation, by the covariance, along each error's own direction n: sqrt(n^T C n).

    Args:
        errors: (N, D).
        covariances: (N, D, D).

    Returns:
        (N,), 0 for an error of zero.
    """
    length = np.linalg.norm(errors, axis=-1, keepdims=True)
    unit = errors / np.where(length > 0, length, 1.0)
    variance = np.einsum("ni,nij,nj->n", unit, covariances, unit)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def direction_errors(linear: Array, true: Array, covariances: Array) -> tuple[Array, Array]:
    """Express the errors of unit directions on the tangent plane of the estimate.

    Args:
        linear: (N, 3) estimated unit directions.
        true: (N, 3) true unit directions.
        covariances: (N, 3, 3) of `linear`.

    Returns:
        Errors (N, 2): their length is the signed angle in radians, 0 to pi, their direction that
        of the shortest turn to the truth. Covariances (N, 2, 2) on the same plane. NaN where a
        direction is.
    """
    errors = np.full((len(linear), 2), np.nan)
    across_all = np.full((len(linear), 2, 2), np.nan)
    for k in np.flatnonzero(np.isfinite(linear).all(axis=1) & np.isfinite(true).all(axis=1)):
        across = np.linalg.svd(linear[k][None])[2][1:]  # (2, 3), a basis across the estimate
        towards = across @ true[k]
        sine = float(np.linalg.norm(np.cross(linear[k], true[k])))
        angle = np.arctan2(sine, float(linear[k] @ true[k]))
        # Of two opposite directions every turn is a shortest one; take the first axis.
        length = float(np.linalg.norm(towards))
        errors[k] = angle * (towards / length if length > 1e-12 else np.array([1.0, 0.0]))
        across_all[k] = across @ covariances[k] @ across.T
    return errors, across_all
