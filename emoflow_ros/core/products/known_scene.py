"""The scene that a window has shown, and the flow that it makes once the camera moves otherwise.

At a node with the flow u0 and the inverse depth rho, both per second, seen under the motion
(w0, v0), another motion (w, v) makes the flow

    u = u0 + b (w - w0) + rho a (v - v0),

with the matrices a and b of the motion field (core.geometry.camera_motion). These are six
unknowns instead of a flow's many hundreds: few events tell them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.known import INFORMATION_EXCESS
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.types.estimate import Estimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KnownScene:
    """Flow and inverse depths at the nodes of a lattice, under a motion of the camera.

    Attributes:
        flow: (nodes, 2) px/s.
        by_motion: (nodes, 2, 6) its derivatives by w (rad/s) and v (in units of the speed).
    """

    flow: Array
    by_motion: Array

    @classmethod
    def at_depths(cls, epipolar: NodeEpipolar, flow: Array, inverse_depth: Array) -> "KnownScene":
        """Take a flow (nodes, 2) and inverse depths (nodes,); zero where v does not count."""
        of_v = inverse_depth[:, None, None] * epipolar.a
        by_motion = np.concatenate([epipolar.b, of_v], axis=-1)
        return cls(flow, by_motion * epipolar.usable[:, None, None])

    def fit(
        self, contrast: Contrast, events: WindowEvents, duration: float, share: float,
        expected: tuple[Array, Array],
    ) -> tuple[Array, Array]:  # fmt: skip
        """Fit the change of the motion to events, by one Newton step on their contrast.

        Args:
            contrast: of the events' images.
            events: of the window.
            duration: of the window, s.
            share: of the window that no other fit has seen: as much of its information counts.
            expected: change (m,), to start from, and its covariance (m, m); m = 3 leaves v as it
                is.

        Returns:
            The change (m,) of w in rad/s and v, and its covariance (m, m).

        Raises:
            numpy.linalg.LinAlgError: there is no best change.
        """
        change, covariance = expected
        by_motion = np.ascontiguousarray(duration * self.by_motion[..., : len(change)])
        cells = contrast.linearise(events, self.field(contrast.lattice, duration, change))
        force, curvature = cells.project(by_motion)
        seen = share / INFORMATION_EXCESS
        fitted = np.linalg.inv(np.linalg.inv(covariance) + seen * curvature)
        return change + fitted @ (seen * force), fitted

    def field(self, lattice: Lattice, duration: float, change: Array) -> NDArray[np.float32]:
        """Flow (columns, rows, times, 2), px per window of `duration` s, after a change (m,)."""
        still = duration * (self.flow + self.by_motion[..., : len(change)] @ change)
        field = np.empty(lattice.shape, np.float32)
        field[:] = still.reshape(lattice.columns, lattice.rows, 1, 2)
        return field


def inverse_depths(epipolar: NodeEpipolar, flow: Array, w: Array, v: Array) -> Array:
    """Read inverse depths (nodes,) off a flow (nodes, 2), 0 at the least.

    Args:
        epipolar: the lattice's constraint.
        flow: per second.
        w, v: (3,) rad per second, and the direction of translation.
    """
    line = epipolar.a @ v
    along = ((flow - epipolar.b @ w) * line).sum(axis=-1)
    return np.maximum(0.0, along / ((line**2).sum(axis=-1) + epipolar.soft**2))


def motion_covariance(estimate: Estimate, v: Array) -> Array:
    """Return the covariance (6, 6) of (w, v) of an estimate, v in units of the speed.

    It turns with v. Along v it is 1: nobody knows how the speed changes. Where v is not known, w
    stands alone.

    Args:
        estimate: of a window.
        v: (3,) unit direction of translation at the time in the window that is asked for.
    """
    order = np.r_[3:6, 0:3]
    covariance: Array = estimate.covariance[np.ix_(order, order)].copy()
    if estimate.translation_observable:
        turn = np.eye(6)
        turn[3:, 3:] = _least_turn(estimate.linear, v)
        covariance = turn @ covariance @ turn.T
        covariance[3:, 3:] += np.outer(v, v)
        return 0.5 * (covariance + covariance.T)
    covariance[3:, :3], covariance[:, 3:] = 0.0, 0.0
    return covariance


def _least_turn(before: Array, after: Array) -> Array:
    """Rotation (3, 3) by the least angle, under 180 degrees, from one unit vector to another."""
    both: Array = np.outer(after, before)
    across = both - both.T  # the cross product with before x after
    turn: Array = np.eye(3) + across + across @ across / max(1e-6, 1 + before @ after)
    return turn
