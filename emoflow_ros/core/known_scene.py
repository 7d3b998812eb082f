"""A scene that is known from a window, and its flow once the camera moves otherwise.

At a node with the flow u0 and the inverse depth rho, both per second, seen under the motion
(w0, v0), another motion (w, v) makes the flow

    u = u0 + b (w - w0) + rho a (v - v0),

with the matrices a and b of the motion field (core.camera_motion). These are six unknowns instead
of a flow's many hundreds: few events tell them.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsbmv

from emoflow_ros.core.belief import INFORMATION_EXCESS
from emoflow_ros.core.contrast import ImageContrast, WindowEvents
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.normal_equations import NormalEquations

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
        self,
        contrast: ImageContrast,
        equations: NormalEquations,
        events: WindowEvents,
        duration: float,
        prior: tuple[Array, Array],
        start: Array,
        steps: int,
    ) -> tuple[Array, Array]:
        """Fit the change of the motion to events, by Newton steps on their contrast.

        Args:
            contrast: at one scale.
            equations: of its lattice; overwritten.
            events: of the window.
            duration: of the window, s.
            prior: expected change (m,) and the information (m, m) on it; m = 3 leaves v as it is.
            start: (m,).
            steps: how many.

        Returns:
            The change (m,) of w in rad/s and v, and the information (m, m) on it.

        Raises:
            numpy.linalg.LinAlgError: there is no best change.
        """
        expected, certainty = prior
        change, information = start, certainty
        by_motion = duration * self.by_motion[..., : len(start)]
        times = equations.lattice.times
        rows = np.repeat(by_motion[:, None], times, axis=1).reshape(-1, len(start))
        for _ in range(steps):
            equations.clear()
            flow = self.field(equations.lattice, duration, change)
            contrast.linearise(events, flow, equations.vector, equations.band)
            force = rows.T @ equations.vector / INFORMATION_EXCESS
            curvature = rows.T @ _times_band(equations.band, rows) / INFORMATION_EXCESS
            information = curvature + certainty
            step = np.linalg.solve(information, force - certainty @ (change - expected))
            change = change + step
        return change, information

    def field(self, lattice: Lattice, duration: float, change: Array) -> NDArray[np.float32]:
        """Flow (columns, rows, times, 2), px per window of `duration` s, after a change (m,)."""
        still = duration * (self.flow + self.by_motion[..., : len(change)] @ change)
        return np.repeat(still[:, None], lattice.times, axis=1).reshape(lattice.shape).astype("f4")


def inverse_depths(epipolar: NodeEpipolar, flow: Array, w: Array, v: Array) -> Array:
    """Read inverse depths (nodes,) off a flow (nodes, 2), 0 at the least.

    Args:
        epipolar: the lattice's constraint.
        flow: per second.
        w, v: (3,) rad per second, and the direction of travel.
    """
    line = epipolar.a @ v
    along = ((flow - epipolar.b @ w) * line).sum(axis=-1)
    return np.maximum(0.0, along / ((line**2).sum(axis=-1) + epipolar.soft**2))


def motion_covariance(estimate: Estimate) -> Array:
    """Return the covariance (6, 6) of (w, v) of an estimate, v in units of the speed.

    Along v it is 1: nobody knows how the speed changes. Where v is not known, w stands alone.
    """
    order = np.r_[3:6, 0:3]
    covariance: Array = estimate.covariance[np.ix_(order, order)].copy()
    if estimate.translation_observable:
        covariance[3:, 3:] += np.outer(estimate.linear, estimate.linear)
    else:
        covariance[3:, :3], covariance[:, 3:] = 0.0, 0.0
    return covariance


def _times_band(band: Array, columns: Array) -> Array:
    """Multiply a symmetric matrix in lower band storage with columns (n, m)."""
    products = [dsbmv(band.shape[1] - 1, 1.0, band.T, column, lower=1) for column in columns.T]
    return np.stack(products, axis=1)
