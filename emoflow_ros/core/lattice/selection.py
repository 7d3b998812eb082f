"""Whether a camera only rotates, as far as one window's flow tells."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.fit import FreeFlow
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.uncertainty import Explanations

Array = NDArray[np.float64]


def rotates(
    epipolar: NodeEpipolar, free: FreeFlow, rotation: Explanations, full: Explanations
) -> bool:
    """Tell whether a rotation alone explains a flow.

    It leaves no more of it, at half of the nodes, than the flow's own error, and costs no more than
    the freedom of a depth at each node explains anyway.

    Args:
        epipolar: the lattice's constraint.
        free: the flow as the events alone see it.
        rotation: the best pure rotation.
        full: the motion that was fitted.
    """
    if rotation.residual[0] >= LATTICE.freedom * full.residual[0]:
        return False
    evidence = epipolar.usable * np.trace(free.information, axis1=1, axis2=2)
    left, flow = (
        _weighted_median(_evident_norm(part, free.information), evidence)
        for part in (free.flow - epipolar.b @ rotation.w[0], free.flow)
    )
    return left <= min(LATTICE.rotation_share * flow, LATTICE.lasting_px2**0.5)


def _evident_norm(flow: Array, information: Array) -> Array:
    """Norm of each node's flow in the directions that events see: edges hide one."""
    seen = ((flow[:, None] @ information)[:, 0] * flow).sum(-1)
    seen = np.maximum(seen, 0.0)  # else rounding may leave less than zero
    return np.sqrt(2 * seen / (np.trace(information, axis1=1, axis2=2) + 1e-12))


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(cumulative, 0.5 * cumulative[-1])])
