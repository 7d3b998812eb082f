"""The flow of a window fitted once more, now that its motion is known.

A window alone shows motion and flow together, and errors of one go into the other. The memory of
positions knows the motion better: with it a static point's flow has one unknown, its depth.
"""

from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice.fit import LatticeFit
from emoflow_ros.core.lattice.known import (
    INFORMATION_EXCESS,
    KnownRotation,
    MotionPrior,
    Structure,
)
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.types.estimate import Estimate, angular_over
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

_TIMES = 9  # at which the motion is read
_LEAST = 1e-9  # variance of an angle, rad^2 per window^2


@dataclass(frozen=True)
class Depths:
    """Inverse depths that are known of points in the image.

    Attributes:
        points: (N, 2) px.
        inverse_depth: (N,) travelled distances per second.
        weight: (N,) how much each counts, 1 where it is surely known.
    """

    points: Array
    inverse_depth: Array
    weight: Array


class ShownFlow(NamedTuple):
    """The flow of a window, which shows depths under any motion that the camera may have had.

    Attributes:
        t: the window's middle, ns.
        seconds: its length.
        epipolar: the constraint at the nodes.
        flow: (nodes, 2) px per window, its mean.
        evidence: (nodes, 2, 2) the events' information on it, in units of the normal equations.
    """

    t: int
    seconds: float
    epipolar: NodeEpipolar
    flow: Array
    evidence: Array

    def inverse_depths(self, angular: Array, linear: Array) -> tuple[Array, Array, Array]:
        """Inverse depths (nodes,), the information on them (nodes,), and how far they count.

        The latter (nodes,) is 1 where the flow is along the epipolar line, 0 where it is not, for
        something moves by itself.

        Args:
            angular: (3,) rad/s at that time.
            linear: (3,) not zero, in the unit of the depths per second.
        """
        way = self.seconds * float(np.linalg.norm(linear))
        w, v = self.seconds * angular, self.seconds * linear / way
        found = Structure.observe(self.epipolar, self.flow, (w, v), self.evidence, None)
        across = self.epipolar.residuals(self.flow[:, None], Motion(w[None], v[None])).r
        static = self.epipolar.robust_weight(across)[:, 0]
        return found.inverse_depth / way, way**2 * found.information, static


class Refined(NamedTuple):
    """A flow that was fitted again.

    Attributes:
        flow: (columns, rows, times, 2) px per window.
        shown: what it shows of the scene; None where the camera only rotates.
    """

    flow: F32
    shown: ShownFlow | None


def refined(
    fit: LatticeFit, begin: F32, events: WindowEvents, estimate: Estimate,
    structure: Structure | None,
) -> Refined | None:  # fmt: skip
    """Fit a flow again; the fit stays as it is.

    Args:
        fit: of the window.
        begin: (columns, rows, times, 2) px per window, the flow to begin with.
        events: of the window.
        estimate: of the window, with the motion that is known.
        structure: depths that are known, in travelled distances per window; None if none are.

    Returns:
        None if there is no best flow, or no motion was fitted.
    """
    seconds = (estimate.t_end - estimate.t_start) / NS_PER_S
    if fit.motion is None:
        return None
    w = rotation_over(estimate)
    of_w = seconds**2 * estimate.covariance[3:, 3:] + _LEAST * np.eye(3)
    again = copy(fit)
    again.flow, again.structure = begin, structure
    again.known = KnownRotation.seen(w, of_w)
    again.config = replace(
        fit.config,
        dec_weight=LATTICE.stiffer * fit.config.dec_weight,
        edge_px=LATTICE.sharper_edges * fit.config.edge_px,
    )
    ends = again.known.ends()
    prior = None
    if estimate.translation_observable:
        again.motion, again.front = Motion(ends, np.stack([estimate.linear] * 2)), 1.0
        prior = _prior(again.known.mean, estimate, seconds)
    else:
        again.motion = replace(fit.motion, w=ends)
    try:
        for _ in range(LATTICE.refining_steps):
            again.linearise(events, 1.0)
            if prior is None:
                again.step_rotation()
            else:
                again.step_coupled(prior)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(again.flow).all():
        return None
    if prior is None:
        return Refined(again.flow, None)
    middle = (estimate.t_start + estimate.t_end) // 2
    flow = again.node_flow.mean(axis=1)
    return Refined(again.flow, ShownFlow(middle, seconds, fit.epipolar, flow, again.evidence))


def rotation_over(estimate: Estimate) -> Array:
    """Angular velocities (T, 3) at times from the start of an estimate's window to its end.

    They are in rad per window. The estimate has a motion.
    """
    assert estimate.motion is not None
    seconds = (estimate.t_end - estimate.t_start) / NS_PER_S
    return seconds * angular_over(estimate.motion, estimate.t_start, estimate.t_end, _TIMES)


def rotation_at_ends(estimate: Estimate) -> Array:
    """Angular velocities (2, 3) at a window's start and end, of its mean and slope; units as above.

    Args:
        estimate: with a motion.
    """
    return KnownRotation.seen(rotation_over(estimate), np.eye(3)).ends()


def rotation_by_parts(estimate: Estimate, parts: int) -> Array:
    """Mean angular velocities (parts, 3) over equal parts of an estimate's window, rad per window.

    That of the whole is not that of the middle where a hand trembles.

    Args:
        estimate: with a motion.
        parts: 1, 2, 4 or 8.
    """
    w = rotation_over(estimate)
    between = (w[:-1] + w[1:]) / 2
    return np.asarray(between.reshape(parts, -1, 3).mean(axis=1))


def _prior(w: Array, estimate: Estimate, seconds: float) -> MotionPrior:
    """What is known of the mean of (w, v) over the window."""
    order = np.r_[3:6, 0:3]
    covariance = estimate.covariance[np.ix_(order, order)].copy()
    covariance[3:, 3:] += np.outer(estimate.linear, estimate.linear)
    unit = np.repeat([seconds, 1.0], 3)
    covariance = covariance * np.outer(unit, unit) + _LEAST * np.eye(6)
    information = INFORMATION_EXCESS * np.linalg.inv(covariance)
    return MotionPrior(np.concatenate([w, estimate.linear]), information)
