"""Which motion the evidence supports: rotation alone, translation alone, or both."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera_motion import cheirality
from emoflow_ros.core.lattice.belief import INFORMATION_EXCESS
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.fit import FreeFlow
from emoflow_ros.core.types.estimate import MotionModel

Array = NDArray[np.float64]

_FORGETTING = 0.6  # weight of the past against the present window

# Measured on rotations and on translations past flat walls (docs/method.md). A pure
# rotation leaves only the flow's own error: less than these at half of the nodes ...
_ERROR_PX = 0.8
_ERROR_SHARE = 0.06
# ... and the full model, with a depth for each node, lowers the cost by this factor anyway.
_FREEDOM = 4.5
# So little that there is nothing else to explain:
_NOTHING_PX = 0.15
_NOTHING_SHARE = 0.015
_HYSTERESIS = 1.25  # of a rotation ...
_INERTIA = 1.5  # ... and of translation, which passes through moments that look like rotation
_STRAIGHT = 0.7  # Wald's statistic up to which a camera that translates is taken not to rotate ...
_ROTATING = 1.2  # ... until it comes to this
_SETTLED = 4  # windows that translation without rotation takes to be believed


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
        rotating: Wald's statistic of w, 1 for a camera that does not rotate.
        windows: how many have been weighed.
        model: the present decision.
    """

    agreement: float = 0.0
    residual_px: float = 0.0
    residual_share: float = 0.0
    advantage: float = 0.0
    rotating: float = 0.0
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
        more = rotation.residual[0] / (_FREEDOM * full.residual[0] + 1e-12)
        left = _evident_norm(free.flow - epipolar.b @ rotation.w[0], free.information)
        speed = _weighted_median(_evident_norm(free.flow, free.information), evidence)
        median = _weighted_median(left, evidence)
        rotating = epipolar.rotating(free.flow, free.information / INFORMATION_EXCESS, v)
        past = _FORGETTING if self.windows else 0.0
        for name, value in (
            ("agreement", agreement),
            ("residual_px", median),
            ("residual_share", median / max(speed, 1e-6)),
            ("advantage", float(np.log(more + 1e-12))),
            ("rotating", rotating),
        ):
            setattr(self, name, past * getattr(self, name) + (1 - past) * value)
        self.windows += 1
        slack = 1.0
        if self.windows > 1:
            slack = _HYSTERESIS if self.model is MotionModel.ROTATION else 1 / _INERTIA
        nothing = (
            self.residual_share < _NOTHING_SHARE * slack or self.residual_px < _NOTHING_PX * slack
        )
        rotates = nothing or (
            self.residual_px < _ERROR_PX * slack
            and self.residual_share < _ERROR_SHARE * slack
            and self.advantage < np.log(slack)
        )
        bound = _ROTATING if self.model is MotionModel.TRANSLATION else _STRAIGHT
        if rotates:
            self.model = MotionModel.ROTATION
        elif self.windows >= _SETTLED and self.rotating < bound and free.known is None:
            self.model = MotionModel.TRANSLATION
        else:
            self.model = MotionModel.FULL
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
