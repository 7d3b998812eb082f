"""Egomotion on the lattice: the DEC as a robust residual in pixels, coupled to the flow.

At a node with flow u (px per window) the residual is what the motion (v, w) leaves across
the epipolar line, r = n . (u - b w) with n normal to a v; a and b are the matrices of the
motion field (core.geometry.camera_motion) mapped through the lens to pixels. It is the DEC divided
by the norm of the line, so that it has the unit and the noise of the flow itself.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_matrices
from emoflow_ros.core.lattice import constraints, rotations
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.uncertainty import Explanations

Array = NDArray[np.float64]


# (3,) rad per window and its information (3, 3)
type Rotation = tuple[Array, Array]
_UNKNOWN: Rotation = (np.zeros(3), np.zeros((3, 3)))

MOTION_UNKNOWNS = 13
OF_W, OF_V = np.r_[0:3, 6:9], np.r_[3:6, 9:12]  # among them, at start and end


@dataclass(frozen=True)
class Residuals:
    """Residuals of all nodes and times, linearised.

    Attributes:
        r: (nodes, times) px per window.
        by_flow: (nodes, times, 2) its derivative by the node's flow, a unit vector.
        by_motion: (nodes, times, 7) its derivative by w and v at its time, and by the speed.
    """

    r: Array
    by_flow: Array
    by_motion: Array

    @classmethod
    def empty(cls, nodes: int, times: int) -> "Residuals":
        """Make room for them."""
        return cls(
            np.empty((nodes, times)),
            np.empty((nodes, times, 2)),
            np.empty((nodes, times, 7)),
        )


@dataclass(frozen=True)
class Motion:
    """The egomotion's unknowns in one window; like the flow it changes linearly.

    As a vector (13,): w and v at the window's start, at its end, then the speed.

    Attributes:
        w: (2, 3) angular velocity at start and end, rad per window.
        v: (2, 3) direction of the linear velocity; the mean has unit norm.
        speed: distance travelled, over that in the window that the structure is known from.
    """

    w: Array
    v: Array
    speed: float = 1.0

    @classmethod
    def constant(cls, w: Array, v: Array, speed: float = 1.0) -> "Motion":
        """Build a motion that does not change."""
        return cls(np.stack([w, w]), np.stack([v, v]), speed)

    @property
    def unknowns(self) -> Array:
        """All of them, (13,)."""
        return np.append(np.hstack([self.w, self.v]), self.speed)

    def at(self, s: float) -> tuple[Array, Array]:
        """Angular velocity (3,) rad per window and unit direction (3,) at s in [0, 1]."""
        shares = np.array([1 - s, s])
        v = shares @ self.v
        return shares @ self.w, v / np.sqrt(v @ v)

    def moved(self, step: Array) -> "Motion":
        """Add a step (13,) and bring v back to unit scale."""
        w, v = np.hsplit(step[:-1].reshape(2, 6), 2)
        v = self.v + v
        mean = v.sum(axis=0) / 2
        return Motion(self.w + w, v / np.sqrt(mean @ mean), self.speed + float(step[-1]))


class NodeEpipolar:
    """The differential epipolar constraint at the nodes of a lattice.

    Args:
        camera: with its lens; nodes where the lens has no inverse are left out.
        lattice: the flow field's.
        inlier_px: residual, px per window, at which a node costs half as much as by squares
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
        # Near the focus of expansion the line's direction is undefined: fade it out there.
        self.px_per_rad = float(np.sqrt(camera.fx * camera.fy))
        self.soft = 1e-3 * self.px_per_rad
        self._directions = _hemisphere(LATTICE.directions)
        self._lines = self._line_fields(self._directions)

    def robust_weight(self, r: Array) -> Array:
        """Geman-McClure weights of residuals in px per window."""
        return self.usable[:, None] / (1 + (r / self.inlier_px) ** 2) ** 2

    def residuals(self, flow: Array, motion: Motion) -> Residuals:
        """Evaluate and linearise the DEC: the flow across the epipolar lines.

        Args:
            flow: (nodes, times, 2) px per window.
            motion: the egomotion.
        """
        residuals = Residuals.empty(*flow.shape[:2])
        constraints.across_lines(
            *self.kernel_arguments(flow, motion),
            residuals.r,
            residuals.by_flow,
            residuals.by_motion,
        )
        return residuals

    def kernel_arguments(
        self, flow: Array, motion: Motion
    ) -> tuple[Array, Array, Array, Array, Array, float]:
        """Return flow, a, b, w and v at each time, and `soft`, as `constraints` takes them."""
        return flow, self.a, self.b, motion.w, motion.v, self.soft

    def rotational_flow(self, motion: Motion) -> Array:
        """Flow of the motion's rotation, (nodes, times, 2) px per window."""
        return np.einsum("nij,tj->nti", self.b, motion.w)

    def search(
        self,
        flow: Array,
        information: Array,
        known: Rotation = _UNKNOWN,
        *,
        sized: bool = True,
    ) -> Explanations:
        """Explain a flow by constant motions, one for each direction of a hemisphere.

        For a given v the residual is linear in w: robust least squares (the DEC does not know v's
        sign). The residual is that across the lines and, where the scene would lie behind the
        camera, all the translational flow.

        Args:
            flow: (nodes, 2) px per window.
            information: (nodes, 2, 2), inverse covariance of the flow.
            known: what else is known of w, in the same units.
            sized: whether motions of less flow are likelier. Not for values that are averaged
                over windows: it draws w to zero.
        """
        return self._explain(self._directions, self._lines, (flow, information, known), sized)

    def score(
        self,
        v: Array,
        flow: Array,
        information: Array,
        known: Rotation = _UNKNOWN,
        *,
        sized: bool = True,
    ) -> Explanations:
        """Explain a flow by the best motion along one direction v (3,), as `search`."""
        return self._explain(v[None], self._line_fields(v[None]), (flow, information, known), sized)

    def rotation(
        self, flow: Array, information: Array, known: Rotation = _UNKNOWN, *, sized: bool = True
    ) -> Explanations:
        """Explain a flow by the pure rotation that leaves least of it, as `search`."""
        w, residual = rotations.best_rotation(
            self.b, flow, self._counted(information), self.usable, self.inlier_px,
            2 * LATTICE.reweightings, *known,
        )  # fmt: skip
        size = rotations.size_of_rotation(w, self.px_per_rad) if sized else 0.0
        return Explanations(np.zeros((1, 3)), w[None], np.array([residual]), np.array([size]))

    def _counted(self, information: Array) -> Array:
        return self.usable[:, None, None] * information

    def _line_fields(self, v: Array) -> Array:
        """Epipolar lines for directions v (M, 3), (M, nodes, 2)."""
        return np.tensordot(v, self.a, axes=(1, 2))

    def _explain(
        self, v: Array, lines: Array, evidence: tuple[Array, Array, Rotation], sized: bool
    ) -> Explanations:
        """Fit w for each v (M, 3) and its field of lines (M, nodes, 2)."""
        flow, information, known = evidence
        depths = LATTICE.independent_depths if sized else 0.0
        found = Explanations(v, np.empty((len(v), 3)), np.empty(len(v)), np.empty(len(v)))
        rotations.best_rotations(
            lines, self.soft, self.b, flow, self._counted(information), self.inlier_px,
            LATTICE.reweightings, *known, depths, self.px_per_rad,
            found.w, found.residual, found.size,
        )  # fmt: skip
        return found


def _hemisphere(count: int) -> Array:
    """Spread unit vectors evenly over the half space z > 0 (a Fibonacci lattice), (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1 - k / count
    azimuth = np.pi * (1 + np.sqrt(5)) * k
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)
