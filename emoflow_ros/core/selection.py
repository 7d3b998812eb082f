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
# A rotation leaves nothing but the flow's own error, about half a pixel or a few percent ...
_ROTATION_RESIDUAL_PX = 0.5
_ROTATION_RESIDUAL_SHARE = 0.03
# ... whose sign is no more in front of the camera than behind it.
_AGREEMENT = 0.85
_HYSTERESIS = 1.25


@dataclass
class ModelSelector:
    """Collects the evidence of successive windows.

    Attributes:
        agreement: share of the translational flow in front of the camera minus that behind
            (cheirality), for +v; its sign decides v's.
        residual: what a pure rotation leaves of the flow, over what it may leave.
        model: the present decision.
    """

    agreement: float = 0.0
    residual: float = 0.0
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
        rotation = epipolar.b @ epipolar.rotation(free.flow, free.information)
        left = _weighted_median(np.linalg.norm(free.flow - rotation, axis=-1), evidence)
        speed = _weighted_median(np.linalg.norm(free.flow, axis=-1), evidence)
        residual = left / max(_ROTATION_RESIDUAL_PX, _ROTATION_RESIDUAL_SHARE * speed)
        past = _FORGETTING if self.windows else 0.0
        self.agreement = past * self.agreement + (1 - past) * agreement
        self.residual = past * self.residual + (1 - past) * residual
        self.windows += 1
        slack = _HYSTERESIS if self.model is MotionModel.ROTATION else 1.0
        rotates = self.residual < slack and abs(self.agreement) < _AGREEMENT * slack
        self.model = MotionModel.ROTATION if rotates else MotionModel.FULL
        return self.model


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, 0.5 * cumulative[-1])])
