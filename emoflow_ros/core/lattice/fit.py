"""Fit of a window: Newton steps on contrast, smoothness and DEC, flow and motion at once."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.constraints import add_constraint, add_structure
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.egomotion import (
    MOTION_UNKNOWNS,
    OF_V,
    OF_W,
    Motion,
    NodeEpipolar,
    Residuals,
    Rotation,
)
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.known import (
    INFORMATION_EXCESS,
    KnownRotation,
    MotionPrior,
    Structure,
)
from emoflow_ros.core.lattice.normal_equations import NormalEquations
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.uncertainty import trusted
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.types.estimate import MotionModel

Array = NDArray[np.float64]

SCALES = (0.25, 0.5, 1.0)

# Mean and change over the window, (6, 13) each, of w and v from the motion's unknowns
_MEAN = np.hstack([0.5 * np.eye(6), 0.5 * np.eye(6), np.zeros((6, 1))])
_CHANGE = np.hstack([-np.eye(6), np.eye(6), np.zeros((6, 1))])


@dataclass(frozen=True)
class FreeFlow:
    """The flow as the events alone see it, one step without the epipolar constraint.

    Attributes:
        flow: (nodes, 2) px per window, the mean over the window.
        information: (nodes, 2, 2) of the events on it.
        known: what else is known of w: its mean over the window in rad, and the information on
            it. Or None.
    """

    flow: Array
    information: Array
    known: Rotation | None = None

    @cached_property
    def seen(self) -> tuple[Array, Array]:
        """The flow and what can be trusted of the information on it, as NodeEpipolar takes it."""
        return self.flow, trusted(self.information)

    @property
    def evidence(self) -> tuple[Array, Array] | tuple[Array, Array, Rotation]:
        """The same with what else is known of w."""
        return self.seen if self.known is None else (*self.seen, self.known)


class LatticeFit:
    """The unknowns of a window and the steps that improve them.

    Attributes:
        flow: (columns, rows, times, 2) px per window.
        motion: the egomotion, or None before the flow is good enough to look for it.
        structure: inverse depths known from earlier windows, or None.
        known: what a gyro says about the window's rotation, or None.
        front: 1 if the scene lies in front of a camera that moves along the motion's v, -1 if along
            -v, 0 if that is not known.
        evidence: (nodes, 2, 2) the events' information on the flow where last linearised.
    """

    def __init__(
        self,
        lattice: Lattice,
        epipolar: NodeEpipolar,
        config: LatticeConfig,
    ) -> None:
        self.lattice = lattice
        self.epipolar = epipolar
        self.config = config
        self.contrasts = {scale: Contrast(lattice, scale) for scale in SCALES}
        self.flow = np.zeros(lattice.shape, np.float32)
        self.motion: Motion | None = None
        self.structure: Structure | None = None
        self.known: KnownRotation | None = None
        self.front = 0.0
        self.evidence = np.zeros((lattice.columns * lattice.rows, 2, 2))
        self._equations = NormalEquations(lattice, MOTION_UNKNOWNS)
        of_w, of_v = config.motion_stiffness * np.stack(
            [change.T @ change for change in np.split(_CHANGE, 2)]
        )
        self._smooth_rotation = epipolar.px_per_rad**2 * of_w
        self._smooth_translation = of_v

    @property
    def node_flow(self) -> Array:
        """The flow as (nodes, times, 2)."""
        return self.flow.reshape(-1, self.lattice.times, 2).astype(np.float64)

    def linearise(self, events: WindowEvents, scale: float) -> None:
        """Set up the normal equations of contrast and smoothness at the present flow."""
        cells = self.contrasts[scale].linearise(events, self.flow)
        self.evidence = cells.node_information()
        self._equations.set_up(cells, self.flow, self.config)

    def free_flow(self) -> FreeFlow:
        """Solve the present normal equations without the epipolar constraint."""
        step = self._equations.solve().reshape(-1, self.lattice.times, 2)
        return FreeFlow((self.node_flow + step).mean(axis=1), self.evidence, self._known_rotation)

    def step_free(self) -> None:
        """Step the flow by contrast and smoothness alone."""
        self._move(self._equations.solve())

    def rotated(self, flow: NDArray[np.float32], w: Array) -> NDArray[np.float32]:
        """Replace the rotation w (3,), rad per window, in a flow by what is known of it."""
        if self.known is None:
            return flow
        ends = self.known.ends() - w
        change = self.epipolar.rotational_flow(Motion(ends, np.ones_like(ends)))
        return (flow + change.reshape(flow.shape)).astype(np.float32)

    def start_rotation(self, w: Array) -> None:
        """Begin anew from the flow of a pure rotation w (3,), rad per window."""
        self.motion = Motion.constant(w, self._require_motion().at(0.5)[1])
        rotation = self.epipolar.rotational_flow(self.motion)
        self.flow = rotation.reshape(self.lattice.shape).astype(np.float32)

    def step_rotation(self) -> None:
        """Step the flow towards a pure rotation, and the rotation towards the flow."""
        epipolar = self.epipolar
        motion = self._require_motion()
        residual = self.node_flow - epipolar.rotational_flow(motion)
        stiffness = LATTICE.stiffer * self.config.dec_weight
        weight = stiffness * epipolar.robust_weight(np.linalg.norm(residual, axis=-1))
        equations = self._equations
        corner, corner_vector = equations.corner, equations.corner_vector
        for d in range(2):
            part = Residuals.empty(*weight.shape)
            part.r[:] = residual[..., d]
            part.by_flow[:] = np.eye(2)[d]
            part.by_motion[..., :3], part.by_motion[..., 3:] = -epipolar.b[:, None, d], 0.0
            equations.add_rows(part.by_flow, part.by_motion, weight, part.r)
        corner += self._smooth_rotation
        corner_vector -= self._smooth_rotation @ motion.unknowns
        if self.known is not None:
            self.known.add_to(motion.w, corner, corner_vector)
        not_asked_for = np.append(OF_V, MOTION_UNKNOWNS - 1)
        corner[not_asked_for, not_asked_for] = 1.0
        step, change = equations.solve_bordered()
        self.motion = motion.moved(change)
        self._move(step)

    def step_coupled(self, prior: MotionPrior | None = None) -> None:
        """Step flow and egomotion together, tied by the epipolar constraint.

        Args:
            prior: what is known of the mean motion over the window.
        """
        motion, epipolar = self._require_motion(), self.epipolar
        at = epipolar.kernel_arguments(self.node_flow, motion)
        add_constraint(
            *at, epipolar.usable, epipolar.inlier_px, self.config.dec_weight, self.front,
            *self._equations.parts,
        )  # fmt: skip
        if self.structure is not None:
            share = LATTICE.structure_trust * INFORMATION_EXCESS / self.lattice.times
            known = self.structure.inverse_depth, self.structure.information
            add_structure(
                *at, epipolar.usable, motion.at(0.5)[1], motion.speed, *known, share,
                *self._equations.parts,
            )  # fmt: skip
        self._add_motion_priors(motion, prior)
        step, change = self._equations.solve_bordered()
        self.motion = motion.moved(change)
        self._move(step)

    @property
    def _known_rotation(self) -> Rotation | None:
        """What the gyro says of w, or that the camera is known not to rotate."""
        if self.known is not None:
            return self.known.mean, self.known.information / INFORMATION_EXCESS
        if self.config.model == MotionModel.TRANSLATION:
            return np.zeros(3), self._of_no_turn * np.eye(3)
        return None

    @property
    def _of_no_turn(self) -> float:
        """Information on each component of w, rad per window, of a camera that does not rotate."""
        return (self.epipolar.px_per_rad / LATTICE.straight_px) ** 2

    def _add_motion_priors(self, motion: Motion, prior: MotionPrior | None) -> None:
        """Add the motion's smoothness, v's scale and what else is known of the motion."""
        unknowns, mean = motion.unknowns, _MEAN @ motion.unknowns
        corner, corner_vector = self._equations.corner, self._equations.corner_vector
        # v has no unit of its own: its stiffness goes by a quarter of the evidence at hand.
        evidence = float(corner[OF_V, OF_V].mean()) / 4
        smooth = self._smooth_rotation + evidence * self._smooth_translation
        if self.config.model == MotionModel.TRANSLATION:
            smooth[OF_W, OF_W] += 2 * INFORMATION_EXCESS * self._of_no_turn
        corner += smooth
        corner_vector -= smooth @ unknowns
        along = mean[3:] @ _MEAN[3:]
        corner += evidence * np.outer(along, along)
        if prior is not None:
            known = _MEAN.T @ prior.information
            corner += known @ _MEAN
            corner_vector -= known @ (mean - prior.mean)
        if self.known is not None:
            self.known.add_to(motion.w, corner, corner_vector)
        diagonal = corner.ravel()[:: MOTION_UNKNOWNS + 1]  # a view
        diagonal += 1e-6 * diagonal + 1e-9

    def _move(self, step: Array) -> None:
        self.flow = (self.flow + step.reshape(self.lattice.shape)).astype(np.float32)

    def _require_motion(self) -> Motion:
        if self.motion is None:
            raise ValueError("coupled steps need a motion to start from")
        return self.motion
