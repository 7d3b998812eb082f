"""Egomotion on the lattice: the DEC as a robust residual in pixels, coupled to the flow.

At a node with flow u (px per window) the residual is what the motion (v, w) leaves across
the epipolar line, r = n . (u - b w) with n normal to a v; a and b are the matrices of the
motion field (core.epipolar) mapped through the lens to pixels. It is the DEC divided by
the norm of the line, so that it has the unit and the noise of the flow itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.epipolar import motion_matrices
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.spline import CONTROL_POINTS, basis

Array = NDArray[np.float64]

_DIRECTIONS = 100  # of v over the hemisphere, about 14 degrees apart
_REWEIGHTINGS = 4


@dataclass(frozen=True)
class Residuals:
    """DEC residuals of all nodes and times, linearised.

    Attributes:
        r: (nodes, times) px per window.
        normal: (nodes, times, 2) its derivative by the flow.
        by_motion: (nodes, times, 24) its derivative by the control points (w, then v).
    """

    r: Array
    normal: Array
    by_motion: Array


@dataclass
class Motion:
    """Control points of the egomotion's spline, for one window.

    Attributes:
        w: (4, 3) angular velocity, rad per window.
        v: (4, 3) direction of the linear velocity; the mean has unit norm.
    """

    w: Array
    v: Array

    @classmethod
    def constant(cls, w: Array, v: Array) -> "Motion":
        """Build the spline of a constant motion."""
        return cls(np.tile(w, (CONTROL_POINTS, 1)), np.tile(v, (CONTROL_POINTS, 1)))

    def at(self, s: float) -> tuple[Array, Array]:
        """Angular velocity (3,) rad per window and unit direction (3,) at s in [0, 1]."""
        weights = basis(s)
        v = weights @ self.v
        return weights @ self.w, v / np.linalg.norm(v)

    def moved(self, step: Array) -> "Motion":
        """Add a step (24,), w then v, and bring v back to unit scale."""
        w = self.w + step[:12].reshape(CONTROL_POINTS, 3)
        v = self.v + step[12:].reshape(CONTROL_POINTS, 3)
        return Motion(w, v / np.linalg.norm(v.mean(axis=0)))


class NodeEpipolar:
    """The differential epipolar constraint at the nodes of a lattice.

    Args:
        camera: with its lens; nodes where the lens has no inverse are left out.
        lattice: the flow field's.
        inlier_px: residual, px per window, at which a node loses half its influence
            (Geman-McClure: moving objects drop out).
    """

    def __init__(self, camera: Camera, lattice: Lattice, inlier_px: float) -> None:
        bearings, jacobian = camera.undistort(lattice.pixels)
        self.usable = np.isfinite(bearings).all(axis=-1)
        self.bearings = np.where(self.usable[:, None], bearings, 0.0)
        self.to_bearing = np.where(self.usable[:, None, None], jacobian, np.eye(2))
        lens = np.linalg.inv(self.to_bearing)
        a, b = motion_matrices(self.bearings)
        self.a = lens @ a
        self.b = lens @ b
        self.inlier_px = inlier_px
        self._basis = basis(np.linspace(0, 1, lattice.times))
        # Near the focus of expansion the line's direction is undefined: fade it out there.
        self._directions = _hemisphere(_DIRECTIONS)
        self.px_per_rad = float(np.sqrt(camera.fx * camera.fy))
        self._soft = 1e-3 * self.px_per_rad

    def robust_weight(self, r: Array) -> Array:
        """Geman-McClure weights of residuals in px per window."""
        return self.usable[:, None] / (1 + (r / self.inlier_px) ** 2) ** 2

    def residuals(self, flow: Array, motion: Motion) -> Residuals:
        """Evaluate and linearise the DEC.

        Args:
            flow: (nodes, times, 2) px per window.
            motion: the egomotion.
        """
        v = self._basis @ motion.v
        translational = flow - self.rotational_flow(motion)
        line = np.einsum("nij,tj->nti", self.a, v)
        norm = np.sqrt((line**2).sum(-1) + self._soft**2)
        normal = np.stack([-line[..., 1], line[..., 0]], -1) / norm[..., None]
        r = (normal * translational).sum(-1)
        by_w = -np.einsum("nti,nij->ntj", normal, self.b)
        turned = np.stack([translational[..., 1], -translational[..., 0]], -1)
        by_line = (turned - (r / norm)[..., None] * line) / norm[..., None]
        by_v = np.einsum("nti,nij->ntj", by_line, self.a)
        by_motion = [np.einsum("tk,ntj->ntkj", self._basis, d) for d in (by_w, by_v)]
        shape = (*r.shape, 3 * CONTROL_POINTS)
        return Residuals(r, normal, np.concatenate([d.reshape(shape) for d in by_motion], -1))

    def rotational_flow(self, motion: Motion) -> Array:
        """Flow of the motion's rotation, (nodes, times, 2) px per window."""
        return np.einsum("nij,tj->nti", self.b, self._basis @ motion.w)

    def rotational_jacobian(self) -> Array:
        """Derivative of `rotational_flow` by w's control points, (nodes, times, 2, 12)."""
        jacobian = np.einsum("tk,nij->ntikj", self._basis, self.b)
        return jacobian.reshape(*jacobian.shape[:3], -1)

    def search(
        self, flow: Array, information: Array, also: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Score constant motions against a flow, over all directions of v.

        For a given v the residual is linear in w: robust least squares for each of the
        directions of a hemisphere (the DEC does not know the sign).

        Args:
            flow: (nodes, 2) px per window.
            information: (nodes, 2, 2), inverse covariance of the flow.
            also: (3,) one more direction, put in front.

        Returns:
            v (M, 3) unit, w (M, 3) rad per window and the robust costs (M,).
        """
        v = self._directions if also is None else np.vstack([also, self._directions])
        line = np.einsum("nij,hj->hni", self.a, v)
        norm = np.sqrt((line**2).sum(-1, keepdims=True) + self._soft**2)
        normal = np.stack([-line[..., 1], line[..., 0]], -1) / norm
        rows = np.einsum("hni,nij->hnj", normal, self.b)
        target = np.einsum("hni,ni->hn", normal, flow)
        evidence = self.usable * np.einsum("hni,nij,hnj->hn", normal, information, normal)
        weight = evidence
        for _ in range(_REWEIGHTINGS):
            weighted = rows * weight[..., None]
            matrix = np.einsum("hni,hnj->hij", weighted, rows) + 1e-9 * np.eye(3)
            w = np.linalg.solve(matrix, np.einsum("hni,hn->hi", weighted, target)[..., None])
            r2 = ((target - np.einsum("hnj,hjx->hn", rows, w)) / self.inlier_px) ** 2
            weight = evidence / (1 + r2) ** 2
        cost = self.inlier_px**2 * (evidence * r2 / (1 + r2)).sum(-1)
        return v, w[..., 0], cost

    def rotation(self, flow: Array, information: Array) -> Array:
        """Fit the pure rotation that explains a flow best, (3,) rad per window.

        Args:
            flow, information: as in `search`.
        """
        weight = self.usable.astype(np.float64)
        w = np.zeros(3)
        for _ in range(3 * _REWEIGHTINGS):
            weighted = information * weight[:, None, None]
            matrix = np.einsum("nia,nij,njb->ab", self.b, weighted, self.b)
            w = np.linalg.solve(
                matrix + 1e-9 * np.eye(3), np.einsum("nia,nij,nj->a", self.b, weighted, flow)
            )
            r2 = ((flow - self.b @ w) ** 2).sum(-1)
            scale = max(self.inlier_px**2, 2 * float(np.median(r2[self.usable])))
            weight = self.usable / (1 + r2 / scale) ** 2
        return w


def _hemisphere(count: int) -> Array:
    """Spread unit vectors evenly over the half space z > 0 (a Fibonacci lattice), (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1 - k / count
    azimuth = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)
