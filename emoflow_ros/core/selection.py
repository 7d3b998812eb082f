"""Which motion the evidence supports: rotation alone, or a direction of travel as well."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.epipolar import cheirality
from emoflow_ros.core.estimate import MotionModel
from emoflow_ros.core.lattice_fit import FreeFlow

Array = NDArray[np.float64]

_FORGETTING = 0.6  # weight of the past against the present window

# Measured on rotations and on translations past flat rooms (docs/method.md):
# a pure rotation leaves of the flow only its error, below this at half of the nodes ...
_FLOW_ERROR_PX = 0.35
_FLOW_ERROR_SHARE = 0.015
# ... and the full model, with a depth for each node, lowers the cost by this factor anyway.
_FREEDOM = 3.2
_HYSTERESIS = 1.25


@dataclass
class ModelSelector:
    """Collects the evidence of successive windows.

    Attributes:
        agreement: share of the translational flow in front of the camera minus that behind
            (cheirality), for +v; its sign decides v's.
        residual: what a pure rotation leaves of the flow, over the flow's own error.
        advantage: cost of the best rotation over that of the best full motion, over what
            the freedom of the latter brings by itself; logarithm.
        model: the present decision.
    """

    agreement: float = 0.0
    residual: float = 0.0
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
        rotation, rotation_cost = epipolar.rotation(free.flow, free.information)
        _, full_cost = epipolar.score(v, free.flow, free.information)
        left = np.linalg.norm(free.flow - epipolar.b @ rotation, axis=-1)
        speed = _weighted_median(np.linalg.norm(free.flow, axis=-1), evidence)
        error = max(_FLOW_ERROR_PX, _FLOW_ERROR_SHARE * speed)
        past = _FORGETTING if self.windows else 0.0
        self.agreement = past * self.agreement + (1 - past) * agreement
        self.residual = past * self.residual + (1 - past) * (
            _weighted_median(left, evidence) / error
        )
        self.advantage = past * self.advantage + (1 - past) * float(
            np.log(rotation_cost / (_FREEDOM * full_cost + 1e-12) + 1e-12)
        )
        self.windows += 1
        slack = _HYSTERESIS if self.model is MotionModel.ROTATION else 1.0
        rotates = self.residual < slack or (
            self.residual < 2 * slack and self.advantage < np.log(slack)
        )
        self.model = MotionModel.ROTATION if rotates else MotionModel.FULL
        return self.model


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, 0.5 * cumulative[-1])])
