"""Whether the evidence supports a rotation alone, or travel, too."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera_motion import cheirality
from emoflow_ros.core.lattice.belief import INFORMATION_EXCESS
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.fit import FreeFlow
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.types.estimate import MotionModel

Array = NDArray[np.float64]


@dataclass
class ModelSelector:
    """Collects the evidence of successive windows.

    Attributes:
        agreement: share of the translational flow in front of the camera minus that behind
            (cheirality), for +v; its sign decides v's.
        residual_px: what a pure rotation leaves of the flow at half of the nodes.
        residual_share: the same over the flow itself.
        advantage: cost of the best rotation over that of the best full motion, over what
            the freedom of the latter brings by itself; logarithm.
        windows: how many have been weighed.
        model: the present decision.
    """

    agreement: float = 0.0
    residual_px: float = 0.0
    residual_share: float = 0.0
    advantage: float = 0.0
    model: MotionModel = MotionModel.FULL
    windows: int = 0

    def update(self, epipolar: NodeEpipolar, free: FreeFlow, w: Array, v: Array) -> MotionModel:
        """Weigh one more window.

        Args:
            epipolar: the lattice's constraint.
            free: the flow as the events alone see it.
            w: (3,) rad per window, v: (3,) the motion that explains it best, v keeping its
                orientation from window to window.
        """
        evidence = epipolar.usable * np.trace(free.information, axis1=1, axis2=2)
        flow = np.einsum("nij,nj->ni", epipolar.to_bearing, free.flow)
        agreement = cheirality(epipolar.bearings, flow, v, w, evidence)
        # The bounds were measured with the information as the contrast tells it.
        known = np.zeros(3), np.zeros((3, 3))
        if free.known is not None:
            known = free.known[0], INFORMATION_EXCESS * free.known[1]
        rotation = epipolar.rotation(free.flow, free.information, known, sized=False)
        full = epipolar.score(v, free.flow, free.information, known, sized=False)
        more = rotation.residual[0] / (LATTICE.freedom * full.residual[0] + 1e-12)
        left = _evident_norm(free.flow - epipolar.b @ rotation.w[0], free.information)
        speed = _weighted_median(_evident_norm(free.flow, free.information), evidence)
        median = _weighted_median(left, evidence)
        past = LATTICE.forgetting if self.windows else 0.0
        for name, value in (
            ("agreement", agreement),
            ("residual_px", median),
            ("residual_share", median / max(speed, 1e-6)),
            ("advantage", float(np.log(more + 1e-12))),
        ):
            setattr(self, name, past * getattr(self, name) + (1 - past) * value)
        self.windows += 1
        slack = 1.0
        if self.windows > 1:
            rotated = self.model is MotionModel.ROTATION
            slack = LATTICE.hysteresis if rotated else 1 / LATTICE.inertia
        nothing = (
            self.residual_share < LATTICE.nothing_share * slack
            or self.residual_px < LATTICE.nothing_px * slack
        )
        rotates = nothing or (
            self.residual_px < LATTICE.rotation_px * slack
            and self.residual_share < LATTICE.rotation_share * slack
            and self.advantage < np.log(slack)
        )
        self.model = MotionModel.ROTATION if rotates else MotionModel.FULL
        return self.model


def _evident_norm(flow: Array, information: Array) -> Array:
    """Norm of each node's flow in the directions that events see: edges hide one."""
    seen = ((flow[:, None] @ information)[:, 0] * flow).sum(-1)
    seen = np.maximum(seen, 0.0)  # else rounding may leave less than zero
    return np.sqrt(2 * seen / (np.trace(information, axis1=1, axis2=2) + 1e-12))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, 0.5 * cumulative[-1])])
