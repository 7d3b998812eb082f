"""How uncertain the egomotion of a window is.

Three parts add up. The normal equations say what white errors of the events do. An error of the
flow that is smooth over the image does not average out: it looks like a rotation or a travel, and
later windows of the same scene repeat it, so that no memory averages it either (a consider
covariance: Jazwinski, Stochastic Processes and Filtering Theory, 1970, section 8.4). And other
directions of travel may explain the flow nearly as well, each with a rotation of its own: the
estimate of w is the mean over them, and their spread counts.

The sum is scaled by the evidence, and how far w is from where the last two windows lead is added:
an estimate that jumps is less certain than its own window says.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.belief import INFORMATION_EXCESS, Belief, KnownRotation
from emoflow_ros.core.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice import Lattice

Array = NDArray[np.float64]

# Chosen on the random recordings with seeds 0 to 59 and those of the shared data (docs/method.md).
_BIAS_PX = 0.15  # each polynomial of the flow's smooth error
_POSSIBLE = 20.0  # cost over that of the best motion at which another one is 1/e as likely
_AS_ROTATION = 20.0  # weight of a camera that only turns, against 1 of each direction of travel
_CLAIMED = 0.45  # rad: spread of the possible directions of travel from which none is claimed
_LASTING = 3  # windows before this one, of which ...
_CONFIRMING = 2  # must have told the same direction, up to ...
_SAME = np.cos(np.radians(40.0))  # and none another one
_SCALE = np.repeat([0.2, 0.41], 3)  # of the sum of the three parts for (v, w), at ...
_USUAL_EVIDENCE = 645.0  # px^-2
_OF_EVIDENCE = -0.8  # exponent
_OF_JUMP = 0.05  # variance of w in squares of its second difference over three windows
_FIRST_JUMP, _LARGEST_JUMP = np.radians([10.0, 60.0])  # rad/s
_WITH_GYRO = np.repeat([0.4, 1.0], 3)  # of the covariance of (v, w) where a gyro takes part
_WIDE = 2.0  # how far a motion may exceed what the flow's size suggests
_ROS_ORDER = np.r_[3:6, 0:3]  # (v, w) from (w, v)


class MotionUncertainty:
    """Covariance of the egomotion of one window after another.

    Args:
        lattice: of the flow.
        epipolar: its constraint.
    """

    def __init__(self, lattice: Lattice, epipolar: NodeEpipolar) -> None:
        self._epipolar = epipolar
        x, y = (2 * lattice.pixels / lattice.pixels.max(axis=0) - 1).T
        shapes = np.stack([np.ones_like(x), x, y, x * y, x * x - 1 / 3, y * y - 1 / 3], axis=-1)
        # Errors of the flow: polynomials of second order, each component by itself.
        self._modes = np.einsum("nm,ij->nimj", shapes, np.eye(2)).reshape(len(x), 2, -1)
        self.forget()

    def forget(self) -> None:
        """Take no other motion into account, before one is known."""
        self._mean = np.zeros(6)
        self._spread = np.zeros((6, 6))
        self._before: list[Array] = []
        self._directions: list[Array] = []

    def claims(self, v: Array) -> bool:
        """Tell whether a direction of travel can be claimed. Call it once per window.

        The motions that are possible have to agree on it, and two of the last three windows must
        have told the same, and none another one: a direction that a few events suggest does not
        last.

        Args:
            v: (3,) unit, with its sign.
        """
        mean = self._mean[3:]
        agree = float(np.trace(self._spread[3:, 3:]) + mean @ mean) < _CLAIMED**2
        told = v if agree else np.zeros(3)
        earlier = [told @ before for before in self._directions if before.any()]
        self._directions = [*self._directions, told][-_LASTING:]
        return agree and len(earlier) >= _CONFIRMING and bool(min(earlier) > _SAME)

    @property
    def mean_rotation(self) -> Array:
        """Mean of the possible angular velocities (3,) less the present one, rad per window."""
        return self._mean[:3]

    def weigh_others(
        self,
        present: tuple[Array, Array],
        travels: tuple[Array, Array, Array],
        rotation: tuple[Array, float],
    ) -> None:
        """Note which other motions explain the flow.

        Args:
            present: (3,) w in rad per window and (3,) unit v of the estimate.
            travels: w and v (M, 3) of others, and their costs (M,) less that of the present motion.
            rotation: w (3,) of a camera that only turns, and its cost, less the same.
        """
        w, v, excess = travels
        signs = np.where(v @ present[1] < 0, -1.0, 1.0)[:, None]
        apart = np.hstack([w - present[0], signs * v - present[1]])
        turns = np.hstack([rotation[0] - present[0], np.zeros(3)])
        apart = np.vstack([apart, turns])
        weight = np.exp(-np.maximum(np.append(excess, rotation[1]), 0.0) / _POSSIBLE)
        weight[-1] *= _AS_ROTATION
        total = 1 + weight.sum()  # the present motion's weight is 1
        self._mean = weight @ apart / total
        moment = (weight[:, None] * apart).T @ apart / total
        self._spread = moment - np.outer(self._mean, self._mean)

    def of_travel(
        self,
        belief: Belief,
        flow: Array,
        information: Array,
        duration: float,
        known: KnownRotation | None = None,
    ) -> Array:
        """Covariance (6, 6) of (v, w), v across its direction, in rad/s for w.

        Args:
            belief: mean and covariance by the normal equations.
            flow: (nodes, 2) px per window.
            information: (nodes, 2, 2) of the events on it.
            duration: of the window, s.
            known: what a gyro says.
        """
        v = belief.v
        matrix, response = self._seen(Motion.constant(belief.w * duration, v), flow, information)
        covariance = self._of_bias(_with(matrix, known), response, flow) + self._spread
        scale = np.eye(6)
        scale[:3, :3] /= duration
        scale[3:, 3:] -= np.outer(v, v)
        covariance = scale @ covariance @ scale.T
        return belief.across() + covariance[np.ix_(_ROS_ORDER, _ROS_ORDER)]

    def of_rotation(
        self,
        belief: Belief,
        flow: Array,
        information: Array,
        duration: float,
        known: KnownRotation | None = None,
    ) -> Array:
        """Covariance (6, 6) of a camera that only turns: that of w, and -1 first for no v.

        Args:
            belief, flow, information, duration, known: as in `of_travel`.
        """
        matrix, response = self._turning(information)
        covariance = without_travel(belief.across())
        covariance[3:, 3:] += self._of_bias(_with(matrix, known), response, flow) / duration**2
        return covariance

    def jump_of(self, w: Array) -> float:
        """Measure how far w (3,) is from where the last two windows lead, rad/s.

        Call it once per window.
        """
        jump = _FIRST_JUMP
        if len(self._before) == 2:
            jump = float(np.linalg.norm(w - 2 * self._before[1] + self._before[0]))
        self._before = [*self._before[-1:], w]
        return jump

    def calibrated(self, covariance: Array, jump: float, evidence: Array) -> Array:
        """Scale a covariance by the evidence, and count a jump of w since the last windows.

        Args:
            covariance: (6, 6) of (v, w), or of w alone with -1 first.
            jump: see `jump_of`.
            evidence: (nodes,) the events' information on the flow (trace), px^-2.
        """
        scale = np.sqrt(_SCALE * ((1 + evidence.sum()) / _USUAL_EVIDENCE) ** _OF_EVIDENCE)
        result: Array = np.outer(scale, scale) * covariance
        result[3:, 3:] += _OF_JUMP * min(jump, _LARGEST_JUMP) ** 2 * np.eye(3)
        return without_travel(result) if covariance[0, 0] < 0 else result

    def with_gyro(self, covariance: Array) -> Array:
        """Scale the covariance (6, 6) of (v, w) of a window in which a gyro took part."""
        scale = np.sqrt(_WITH_GYRO)
        return np.asarray(np.outer(scale, scale) * covariance)

    def of_events(self, flow: Array, information: Array, v: Array | None) -> tuple[Array, Array]:
        """Angular velocity that the events of one window tell by themselves.

        Args:
            flow: (nodes, 2) px per window, without the epipolar constraint.
            information: (nodes, 2, 2) of the events on it.
            v: (3,) unit direction of travel to start from; None for a camera that only turns.

        Returns:
            w (3,) rad per window and its covariance (3, 3).
        """
        if v is None:
            w, _ = self._epipolar.rotation(flow, information)
            matrix, response = self._turning(information)
        else:
            w, v, _ = self._epipolar.refine(flow, information / INFORMATION_EXCESS, v)
            matrix, response = self._seen(Motion.constant(w, v), flow, information)
        regular = matrix + 1e-9 * np.trace(matrix) * np.eye(len(matrix))
        covariance = np.linalg.inv(regular) + self._of_bias(matrix, response, flow)
        return w, covariance[:3, :3]

    def _seen(self, motion: Motion, flow: Array, information: Array) -> tuple[Array, Array]:
        """Information (6, 6) of the events on a constant motion (w, v), and its response.

        The response (6, modes) is to the modes of the flow's error.
        """
        residuals = self._epipolar.residuals(flow[:, None], motion)
        normal, r = residuals.by_flow[:, 0], residuals.r[:, 0]
        rows = residuals.constant_motion
        weight = np.einsum("ni,nij,nj->n", normal, information, normal)
        weight *= self._epipolar.robust_weight(r[:, None])[:, 0] / INFORMATION_EXCESS
        matrix = np.einsum("n,ni,nj->ij", weight, rows, rows)
        v = motion.at(0.5)[1]
        matrix[3:, 3:] += np.trace(matrix[3:, 3:]) * np.outer(v, v)  # its length is unknown
        return matrix, np.einsum("n,ni,nj,njm->im", weight, rows, normal, self._modes)

    def _turning(self, information: Array) -> tuple[Array, Array]:
        """As `_seen`, of a camera that only turns: (3, 3) and (3, modes)."""
        b, usable = self._epipolar.b, self._epipolar.usable
        weighted = np.einsum("nij,njk->nik", information, b) * usable[:, None, None]
        weighted /= INFORMATION_EXCESS
        matrix = np.einsum("nij,nik->jk", b, weighted)
        return matrix, np.einsum("nij,nim->jm", weighted, self._modes)

    def _of_bias(self, matrix: Array, response: Array, flow: Array) -> Array:
        """Propagate the flow's smooth error: the motion's normal matrix and response to it."""
        speed = float(np.sqrt(np.mean((flow**2).sum(axis=-1)))) / self._epipolar.px_per_rad
        prior = np.ones(len(matrix))
        prior[:3] = (_WIDE * speed + 1e-3) ** -2
        gain = np.linalg.solve(matrix + np.diag(prior), response)
        return np.asarray(_BIAS_PX**2 * gain @ gain.T)


def _with(matrix: Array, known: KnownRotation | None) -> Array:
    """Add what a gyro says about w to the information (M, M) of the events, w first."""
    if known is None:
        return matrix
    sum_ = matrix.copy()
    sum_[:3, :3] += known.information / INFORMATION_EXCESS
    return sum_


def without_travel(covariance: Array) -> Array:
    """Mark the covariance (6, 6) of (v, w) as without v (REP-145's idiom)."""
    result = np.zeros((6, 6))
    result[0, 0] = -1.0
    result[3:, 3:] = covariance[3:, 3:]
    return result
