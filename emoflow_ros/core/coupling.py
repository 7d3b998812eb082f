"""Terms that tie flow and egomotion, each added to the normal equations in one compiled call.

Residuals are those of core.constraints, with robust weights (Geman-McClure).
"""

import numba
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.constraints import across_lines, along_lines
from emoflow_ros.core.normal_equations import add_rows

F64 = NDArray[np.float64]

_STRUCTURE_INLIER_PX = 1.0

_compiled = numba.njit(cache=True, nogil=True)


@_compiled
def add_constraint(
    flow: F64, a: F64, b: F64, w: F64, v: F64, soft: float,
    usable: NDArray[np.bool_], inlier: float, stiffness: float, front: float,
    vector: F64, band: F64, border: F64, corner: F64, corner_vector: F64,
) -> None:  # fmt: skip
    """Add the DEC, and what of the flow would come from behind the camera.

    Such flow is held against that of an infinite depth, the nearest possible one.

    Args:
        flow, a, b, w, v, soft: as `constraints.across_lines` takes them.
        usable: (nodes,) which nodes count.
        inlier: residual, px per window, at which the weight is a quarter.
        stiffness: weight of a residual of 0.
        front: 1 if the scene lies in front of a camera that moves along v, -1 if along -v, 0 if
            that is not known.
        vector, band, border, corner, corner_vector: of NormalEquations, added to.
    """
    nodes, times = flow.shape[0], flow.shape[1]
    r, weight = np.empty((nodes, times)), np.empty((nodes, times))
    by_flow, by_motion = np.empty((nodes, times, 2)), np.empty((nodes, times, 7))
    across_lines(flow, a, b, w, v, soft, r, by_flow, by_motion)
    for n in range(nodes):
        for t in range(times):
            weight[n, t] = stiffness * _robust_weight(r[n, t], inlier) if usable[n] else 0.0
    add_rows(by_flow, by_motion, weight, r, vector, band, border, corner, corner_vector)
    if front == 0.0:
        return
    along_lines(flow, a, b, w, v, soft, 1.0, np.zeros(nodes), r, by_flow, by_motion)
    for n in range(nodes):
        for t in range(times):
            counts = usable[n] and front * r[n, t] < 0
            weight[n, t] = stiffness * _robust_weight(r[n, t], inlier) if counts else 0.0
    add_rows(by_flow, by_motion, weight, r, vector, band, border, corner, corner_vector)


@_compiled
def add_structure(
    flow: F64, a: F64, b: F64, w: F64, v: F64, soft: float,
    usable: NDArray[np.bool_], heading: F64, speed: float, inverse_depth: F64, information: F64,
    share: float,
    vector: F64, band: F64, border: F64, corner: F64, corner_vector: F64,
) -> None:  # fmt: skip
    """Add what is known of the depths: the length of the flow along the epipolar lines.

    Args:
        heading: (3,) v in the middle of the window.
        speed: as `constraints.along_lines` takes it.
        inverse_depth, information: (nodes,) of belief.Structure.
        share: of that information which counts at each time.
        flow, a, b, w, v, soft, usable: as in `add_constraint`.
        vector, band, border, corner, corner_vector: likewise.
    """
    nodes, times = flow.shape[0], flow.shape[1]
    r, weight = np.empty((nodes, times)), np.zeros((nodes, times))
    by_flow, by_motion = np.empty((nodes, times, 2)), np.empty((nodes, times, 7))
    along_lines(flow, a, b, w, v, soft, speed, inverse_depth, r, by_flow, by_motion)
    for n in range(nodes):
        if not (usable[n] and information[n] > 0):
            continue
        squared = soft * soft
        for d in range(2):
            line = a[n, d, 0] * heading[0] + a[n, d, 1] * heading[1] + a[n, d, 2] * heading[2]
            squared += line * line
        variance = squared / information[n]
        inlier = np.sqrt(9 * variance + _STRUCTURE_INLIER_PX**2)
        for t in range(times):
            weight[n, t] = share / variance * _robust_weight(r[n, t], inlier)
    add_rows(by_flow, by_motion, weight, r, vector, band, border, corner, corner_vector)


@_compiled
def _robust_weight(r: float, inlier: float) -> float:
    ratio = r / inlier
    inverse = 1 / (1 + ratio * ratio)
    return inverse * inverse
