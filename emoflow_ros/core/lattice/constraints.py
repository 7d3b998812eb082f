"""The epipolar constraint on the lattice, in numba: residuals, and what they add to a fit.

At a node with flow u, px per window, a motion (w, v) leaves the translational flow u - b w. It
ought to lie along the epipolar line l = a v of core.geometry.camera_motion, mapped through the lens
to pixels.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.normal_equations import add_rows
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.numerics.jit import fast

F64 = NDArray[np.float64]

_STRUCTURE_INLIER_PX = LATTICE.structure_inlier_px  # numba reads no fields

_compiled, _inlined = fast(), fast(inline="always")


@_inlined
def across_lines(
    flow: F64, a: F64, b: F64, w: F64, v: F64, soft: float, r: F64, by_flow: F64, by_motion: F64,
) -> None:  # fmt: skip
    """Evaluate and linearise r = n . (u - b w), n the unit normal to the line.

    Args:
        flow: (nodes, times, 2).
        a, b: (nodes, 2, 3) px per window.
        w, v: (times, 3) the motion.
        soft: px per window, keeps the line's norm from being zero.
        r: (nodes, times), written.
        by_flow: (nodes, times, 2), written: n.
        by_motion: (nodes, times, 7), written: by w and v at the residual's time, and the speed.
    """
    for n in range(flow.shape[0]):
        for t in range(flow.shape[1]):
            ux, uy, lx, ly, norm = _split(flow[n, t], a[n], b[n], w[t], v[t], soft)
            nx, ny = -ly / norm, lx / norm
            r[n, t] = nx * ux + ny * uy
            by_flow[n, t, 0], by_flow[n, t, 1] = nx, ny
            by_lx = (uy - r[n, t] * lx / norm) / norm
            by_ly = (-ux - r[n, t] * ly / norm) / norm
            _chain(nx, ny, by_lx, by_ly, a[n], b[n], by_motion[n, t])
            by_motion[n, t, -1] = 0.0


@_inlined
def along_lines(
    flow: F64, a: F64, b: F64, w: F64, v: F64, soft: float, speed: float,
    inverse_depth: F64, r: F64, by_flow: F64, by_motion: F64,
) -> None:  # fmt: skip
    """Evaluate and linearise r = l / |l| . (u - b w) - speed |l| / Z, with a known depth Z.

    Args:
        speed: distance travelled, over the one that the depths are measured by.
        inverse_depth: (nodes,) 1 / Z.
        flow, a, b, w, v, soft: as in `across_lines`.
        r, by_flow, by_motion: likewise, written; by_flow is l / |l|.
    """
    for n in range(flow.shape[0]):
        for t in range(flow.shape[1]):
            ux, uy, lx, ly, norm = _split(flow[n, t], a[n], b[n], w[t], v[t], soft)
            ex, ey = lx / norm, ly / norm
            length = ex * ux + ey * uy
            r[n, t] = length - speed * inverse_depth[n] * norm
            by_flow[n, t, 0], by_flow[n, t, 1] = ex, ey
            stretch = speed * inverse_depth[n]
            by_lx = (ux - length * ex) / norm - stretch * ex
            by_ly = (uy - length * ey) / norm - stretch * ey
            _chain(ex, ey, by_lx, by_ly, a[n], b[n], by_motion[n, t])
            by_motion[n, t, -1] = -inverse_depth[n] * norm


@_compiled
def add_constraint(
    flow: F64, a: F64, b: F64, w: F64, v: F64, soft: float,
    usable: NDArray[np.bool_], inlier: float, stiffness: float, front: float,
    vector: F64, band: F64, border: F64, corner: F64, corner_vector: F64,
) -> None:  # fmt: skip
    """Add the epipolar constraint (DEC), and a penalty on flow of what would lie behind the camera.

    Such flow is held against that of an infinite depth, the nearest possible one.

    Args:
        flow, a, b, w, v, soft: as in `across_lines`.
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
        speed: as in `along_lines`.
        inverse_depth, information: (nodes,) of known.Structure.
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
        inlier = np.sqrt(9 * variance + _STRUCTURE_INLIER_PX * _STRUCTURE_INLIER_PX)
        for t in range(times):
            weight[n, t] = share / variance * _robust_weight(r[n, t], inlier)
    add_rows(by_flow, by_motion, weight, r, vector, band, border, corner, corner_vector)


@_inlined
def _split(
    flow: F64, a: F64, b: F64, turn: F64, heading: F64, soft: float
) -> tuple[float, float, float, float, float]:
    """Return translational flow, epipolar line and the line's norm at a node."""
    ux, uy, lx, ly = flow[0], flow[1], 0.0, 0.0
    for j in range(3):
        ux -= b[0, j] * turn[j]
        uy -= b[1, j] * turn[j]
        lx += a[0, j] * heading[j]
        ly += a[1, j] * heading[j]
    return ux, uy, lx, ly, np.sqrt(lx * lx + ly * ly + soft * soft)


@_inlined
def _chain(by_x: float, by_y: float, by_lx: float, by_ly: float, a: F64, b: F64, out: F64) -> None:
    """Chain derivatives by flow and line to those by w and v."""
    for j in range(3):
        out[j] = -(by_x * b[0, j] + by_y * b[1, j])
        out[3 + j] = by_lx * a[0, j] + by_ly * a[1, j]


@_inlined
def _robust_weight(r: float, inlier: float) -> float:
    ratio = r / inlier
    inverse = 1 / (1 + ratio * ratio)
    return inverse * inverse
