"""Inner loops of the epipolar constraint on the lattice, in numba.

At a node with flow u, px per window, a motion (w, v) leaves the translational flow u - b w. It
ought to lie along the epipolar line l = a v of core.camera_motion, mapped through the lens to
pixels.
"""

import numba
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_compiled = numba.njit(cache=True, nogil=True)


@_compiled
def across_lines(
    flow: F64, a: F64, b: F64, basis: F64, w: F64, v: F64, soft: float,
    r: F64, by_flow: F64, by_motion: F64,
) -> None:  # fmt: skip
    """Evaluate and linearise r = n . (u - b w), n the unit normal to the line.

    Args:
        flow: (nodes, times, 2).
        a, b: (nodes, 2, 3) px per window.
        basis: (times, points) of the spline.
        w, v: (points, 3) its control points.
        soft: px per window, keeps the line's norm from being zero.
        r: (nodes, times), written.
        by_flow: (nodes, times, 2), written: n.
        by_motion: (nodes, times, 6 points + 1), written: by w's points, v's points, speed.
    """
    turns, headings = basis @ w, basis @ v
    for n in range(flow.shape[0]):
        for t in range(flow.shape[1]):
            ux, uy, lx, ly, norm = _split(flow[n, t], a[n], b[n], turns[t], headings[t], soft)
            nx, ny = -ly / norm, lx / norm
            r[n, t] = nx * ux + ny * uy
            by_flow[n, t, 0], by_flow[n, t, 1] = nx, ny
            by_lx = (uy - r[n, t] * lx / norm) / norm
            by_ly = (-ux - r[n, t] * ly / norm) / norm
            _chain(nx, ny, by_lx, by_ly, a[n], b[n], basis[t], by_motion[n, t])
            by_motion[n, t, -1] = 0.0


@_compiled
def along_lines(
    flow: F64, a: F64, b: F64, basis: F64, w: F64, v: F64, soft: float, speed: float,
    inverse_depth: F64, r: F64, by_flow: F64, by_motion: F64,
) -> None:  # fmt: skip
    """Evaluate and linearise r = l / |l| . (u - b w) - speed |l| / Z, with a known depth Z.

    Args:
        speed: distance travelled, over the one that the depths are measured by.
        inverse_depth: (nodes,) 1 / Z.
        flow, a, b, basis, w, v, soft: as in `across_lines`.
        r, by_flow, by_motion: likewise, written; by_flow is l / |l|.
    """
    turns, headings = basis @ w, basis @ v
    for n in range(flow.shape[0]):
        for t in range(flow.shape[1]):
            ux, uy, lx, ly, norm = _split(flow[n, t], a[n], b[n], turns[t], headings[t], soft)
            ex, ey = lx / norm, ly / norm
            length = ex * ux + ey * uy
            r[n, t] = length - speed * inverse_depth[n] * norm
            by_flow[n, t, 0], by_flow[n, t, 1] = ex, ey
            stretch = speed * inverse_depth[n]
            by_lx = (ux - length * ex) / norm - stretch * ex
            by_ly = (uy - length * ey) / norm - stretch * ey
            _chain(ex, ey, by_lx, by_ly, a[n], b[n], basis[t], by_motion[n, t])
            by_motion[n, t, -1] = -inverse_depth[n] * norm


@_compiled
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


@_compiled
def _chain(
    by_x: float, by_y: float, by_lx: float, by_ly: float, a: F64, b: F64, basis: F64, out: F64
) -> None:
    """Chain derivatives by flow and line to those by the control points of w and v."""
    points = len(basis)
    for j in range(3):
        by_w = -(by_x * b[0, j] + by_y * b[1, j])
        by_v = by_lx * a[0, j] + by_ly * a[1, j]
        for k in range(points):
            out[3 * k + j] = basis[k] * by_w
            out[3 * (points + k) + j] = basis[k] * by_v


@_compiled
def best_rotations(
    normal: F64, b: F64, flow: F64, evidence: F64, inlier: float, reweightings: int,
    known: F64, information: F64, w: F64, cost: F64,
) -> None:  # fmt: skip
    """Fit a rotation to each field of normals: robust least squares in n . (u - b w).

    What of the scene would lie behind the camera costs its whole u - b w, not the part across the
    line alone: no depth explains it. v's sign is the one that makes this cheaper.

    Args:
        normal: (M, nodes, 2) unit normals of the epipolar lines of M directions of v.
        b: (nodes, 2, 3).
        flow: (nodes, 2) px per window.
        evidence: (nodes, 2, 2) inverse covariance of the flow; zero where it does not count.
        inlier: px per window, of the Geman-McClure weights.
        reweightings: least squares solutions.
        known: (3,) what w is expected to be.
        information: (3, 3) of that; zero where nothing is known.
        w: (M, 3), written.
        cost: (M,), written.
    """
    nodes = len(flow)
    row, target, certain, weight = (
        np.empty((nodes, 3)), np.empty(nodes), np.empty(nodes), np.empty(nodes),
    )  # fmt: skip
    for m in range(len(normal)):
        for n in range(nodes):
            x, y = normal[m, n, 0], normal[m, n, 1]
            target[n] = x * flow[n, 0] + y * flow[n, 1]
            certain[n] = (
                x * x * evidence[n, 0, 0]
                + 2 * x * y * evidence[n, 0, 1]
                + y * y * evidence[n, 1, 1]
            )
            weight[n] = certain[n]
            for j in range(3):
                row[n, j] = x * b[n, 0, j] + y * b[n, 1, j]
        for _ in range(reweightings):
            matrix, vector = information.copy(), information @ known
            for n in range(nodes):
                for i in range(3):
                    weighted = weight[n] * row[n, i]
                    vector[i] += weighted * target[n]
                    for j in range(3):
                        matrix[i, j] += weighted * row[n, j]
            w[m] = np.linalg.solve(_regular(matrix), vector)
            for n in range(nodes):
                r = target[n]
                for j in range(3):
                    r -= row[n, j] * w[m, j]
                weight[n] = certain[n] / (1 + (r / inlier) ** 2) ** 2
        ahead, behind = 0.0, 0.0
        for n in range(nodes):
            x, y = flow[n, 0], flow[n, 1]
            for j in range(3):
                x -= b[n, 0, j] * w[m, j]
                y -= b[n, 1, j] * w[m, j]
            nx, ny = normal[m, n, 0], normal[m, n, 1]
            r = nx * x + ny * y
            across = _robust(nx * r, ny * r, evidence[n], inlier)
            whole = _robust(x, y, evidence[n], inlier)
            in_front = ny * x - nx * y > 0
            ahead += across if in_front else whole
            behind += whole if in_front else across
        cost[m] = min(ahead, behind) + _surprise(w[m] - known, information)


@_compiled
def best_rotation(
    b: F64, flow: F64, evidence: F64, usable: NDArray[np.bool_], inlier: float, reweightings: int,
    known: F64, information: F64,
) -> tuple[F64, float]:  # fmt: skip
    """Fit the pure rotation that leaves least of a flow; the bound for inliers grows with the rest.

    Args:
        usable: (nodes,) which nodes count.
        b, flow, evidence, inlier, reweightings, known, information: as in `best_rotations`.

    Returns:
        w (3,), and the robust cost.
    """
    nodes = len(flow)
    weight, r2, w = np.ones(nodes), np.zeros(nodes), np.zeros(3)
    cost = 0.0
    for _ in range(reweightings):
        matrix, vector = information.copy(), information @ known
        for n in range(nodes):
            for i in range(3):
                px = b[n, 0, i] * evidence[n, 0, 0] + b[n, 1, i] * evidence[n, 0, 1]
                py = b[n, 0, i] * evidence[n, 0, 1] + b[n, 1, i] * evidence[n, 1, 1]
                vector[i] += weight[n] * (px * flow[n, 0] + py * flow[n, 1])
                for j in range(3):
                    matrix[i, j] += weight[n] * (px * b[n, 0, j] + py * b[n, 1, j])
        w = np.linalg.solve(_regular(matrix), vector)
        cost = _surprise(w - known, information)
        for n in range(nodes):
            x, y = flow[n, 0], flow[n, 1]
            for j in range(3):
                x -= b[n, 0, j] * w[j]
                y -= b[n, 1, j] * w[j]
            r2[n] = x * x + y * y
            squares = (
                x * x * evidence[n, 0, 0]
                + 2 * x * y * evidence[n, 0, 1]
                + y * y * evidence[n, 1, 1]
            )
            cost += squares / (1 + r2[n] / inlier**2)
        scale = max(inlier**2, 2 * np.median(r2[usable]))
        for n in range(nodes):
            weight[n] = 1 / (1 + r2[n] / scale) ** 2
    return w, cost


@_compiled
def _surprise(apart: F64, information: F64) -> float:
    """Cost of a rotation that lies `apart` (3,) from what is known."""
    return float(apart @ (information @ apart))


@_compiled
def _robust(x: float, y: float, evidence: F64, inlier: float) -> float:
    """Geman-McClure cost of a residual (x, y) in px per window."""
    return _square(x, y, evidence) / (1 + (x * x + y * y) / inlier**2)


@_compiled
def _square(x: float, y: float, matrix: F64) -> float:
    """Square of the vector (x, y) in the metric of a symmetric matrix (2, 2)."""
    return x * x * matrix[0, 0] + 2 * x * y * matrix[0, 1] + y * y * matrix[1, 1]


@_compiled
def _regular(matrix: F64) -> F64:
    """Keep a matrix (3, 3) of too little evidence from being singular."""
    extent = 1e-9 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2]) + 1e-9
    for i in range(3):
        matrix[i, i] += extent
    return matrix
