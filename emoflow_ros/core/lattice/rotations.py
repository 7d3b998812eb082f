"""Rotations that explain a flow, for given epipolar lines or alone, in numba."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.numerics.jit import fast, njit

F64 = NDArray[np.float64]

_LEAST_FLOW_PX = LATTICE.least_flow_px  # numba reads no fields

_compiled = njit(nogil=True)


@fast()
def best_rotations(
    line: F64, soft: float, b: F64, flow: F64, evidence: F64, inlier: float, reweightings: int,
    known: F64, information: F64, depths: float, px_per_rad: float,
    w: F64, residual: F64, size: F64,
) -> None:  # fmt: skip
    """Fit a rotation to each field of epipolar lines: robust least squares in n . (u - b w).

    n is the unit normal to the line. What of the scene would lie behind the camera costs its whole
    u - b w, not the part across the line alone: no depth explains it. v's sign is the one that
    makes this cheaper. The size of both parts of the flow has a cost of its own (docs/method.md):

        depths sum weight [ln(1 + e) + q^2 / (var (1 + e))] + ln(|w|^2 f^2 + least^2)

    with q the translational flow along the lines, var its variance, e var the variance that depths
    of an unknown common scale give it, and f the focal length.

    Args:
        line: (M, nodes, 2) epipolar lines a v of M directions of v.
        soft: px per window, keeps the lines' norms from being zero.
        b: (nodes, 2, 3).
        flow: (nodes, 2) px per window.
        evidence: (nodes, 2, 2) inverse covariance of the flow; zero where it does not count.
        inlier: px per window, of the Geman-McClure weights.
        reweightings: least squares solutions.
        known: (3,) what w is expected to be.
        information: (3, 3) of that; zero where nothing is known.
        depths: independent depths per node; 0 leaves the size of both parts out.
        px_per_rad: focal length.
        w: (M, 3), written.
        residual, size: (M,) costs, written.
    """
    nodes = len(flow)
    side, length = np.empty(nodes), np.empty(nodes)  # the flow across and along the lines
    of_side, of_length = np.empty(nodes), np.empty(nodes)  # the evidence on both
    across, along = np.empty((3, nodes)), np.empty((3, nodes))  # of the rotation
    weight, squared = np.empty(nodes), np.empty(nodes)
    for m in range(len(line)):
        for n in range(nodes):
            lx, ly = line[m, n, 0], line[m, n, 1]
            squared[n] = lx * lx + ly * ly + soft * soft
            norm = np.sqrt(squared[n])
            x, y = lx / norm, ly / norm
            side[n] = x * flow[n, 1] - y * flow[n, 0]
            length[n] = x * flow[n, 0] + y * flow[n, 1]
            of_side[n] = _square(-y, x, evidence[n])
            of_length[n] = _square(x, y, evidence[n])
            weight[n] = 1.0
            for j in range(3):
                across[j, n] = x * b[n, 1, j] - y * b[n, 0, j]
                along[j, n] = x * b[n, 0, j] + y * b[n, 1, j]
        share, scale, shrinking = 0.0, 1.0, 0.0  # the first solution does not know any size
        for _ in range(reweightings):
            matrix, vector = information.copy(), information @ known
            _add_squares(weight * of_side, across, side, matrix, vector)
            if share > 0:
                of_size = share * weight * of_length / (1 + of_length * scale * squared)
                _add_squares(of_size, along, length, matrix, vector)
            for i in range(3):
                matrix[i, i] += shrinking
            w0, w1, w2 = _solve(_regular(matrix), vector)
            w[m, 0], w[m, 1], w[m, 2] = w0, w1, w2
            moved, reach = 0.0, 1e-9
            for n in range(nodes):
                r = side[n] - across[0, n] * w0 - across[1, n] * w1 - across[2, n] * w2
                q = length[n] - along[0, n] * w0 - along[1, n] * w1 - along[2, n] * w2
                inverse = 1 / (1 + r * r / (inlier * inlier))
                weight[n] = inverse * inverse
                moved += weight[n] * of_length[n] * (q * q + _LEAST_FLOW_PX * _LEAST_FLOW_PX)
                reach += weight[n] * of_length[n] * squared[n]
            share, scale = depths, moved / reach
            if depths > 0:
                least = _LEAST_FLOW_PX / px_per_rad
                shrinking = 1 / (w0 * w0 + w1 * w1 + w2 * w2 + least * least)
        ahead, behind, sizes = 0.0, 0.0, 0.0
        for n in range(nodes):
            r, q = side[n], length[n]
            for j in range(3):
                r -= across[j, n] * w[m, j]
                q -= along[j, n] * w[m, j]
            beside = of_side[n] * r * r / (1 + r * r / (inlier * inlier))
            lx, ly = line[m, n, 0] / np.sqrt(squared[n]), line[m, n, 1] / np.sqrt(squared[n])
            whole = _robust(lx * q - ly * r, ly * q + lx * r, evidence[n], inlier)
            ahead += beside if q > 0 else whole
            behind += whole if q > 0 else beside
            if depths > 0:
                excess = of_length[n] * scale * squared[n]
                sizes += weight[n] * (np.log(1 + excess) + of_length[n] * q * q / (1 + excess))
        residual[m] = min(ahead, behind) + _surprise(w[m] - known, information)
        size[m] = 0.0
        if depths > 0:
            size[m] = depths * sizes + size_of_rotation(w[m], px_per_rad)


@fast(inline="always")
def _add_squares(weight: F64, rows: F64, values: F64, matrix: F64, vector: F64) -> None:
    """Add weighted squares of values (nodes,) - w . rows (3, nodes) to normal equations of w."""
    a, b, c = rows[0], rows[1], rows[2]
    aa = ab = ac = bb = bc = cc = x = y = z = 0.0
    for n in range(len(weight)):
        wa, wb, wc = weight[n] * a[n], weight[n] * b[n], weight[n] * c[n]
        aa, ab, ac = aa + wa * a[n], ab + wa * b[n], ac + wa * c[n]
        bb, bc, cc = bb + wb * b[n], bc + wb * c[n], cc + wc * c[n]
        x, y, z = x + wa * values[n], y + wb * values[n], z + wc * values[n]
    for i, row in enumerate(((aa, ab, ac), (ab, bb, bc), (ac, bc, cc))):
        for j in range(3):
            matrix[i, j] += row[j]
    vector[0] += x
    vector[1] += y
    vector[2] += z


@_compiled
def _solve(matrix: F64, vector: F64) -> tuple[float, float, float]:
    """Solve a symmetric positive definite system (3, 3), by its Cholesky factor; else NaN."""
    a = np.sqrt(matrix[0, 0])
    b, c = matrix[1, 0] / a, matrix[2, 0] / a
    d = np.sqrt(matrix[1, 1] - b * b)
    e = (matrix[2, 1] - b * c) / d
    f = np.sqrt(matrix[2, 2] - c * c - e * e)
    x = vector[0] / a
    y = (vector[1] - b * x) / d
    z = (vector[2] - c * x - e * y) / f / f
    y = (y - e * z) / d
    return (x - b * y - c * z) / a, y, z


@_compiled
def size_of_rotation(w: F64, px_per_rad: float) -> float:
    """Logarithm of the square of the flow, px, that a rotation w (3,) makes."""
    rotation, least = (w @ w) * px_per_rad * px_per_rad, _LEAST_FLOW_PX * _LEAST_FLOW_PX
    return float(np.log(rotation + least))


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
    weight, r2, w = np.ones(len(flow)), np.empty(len(flow)), np.zeros(3)
    cost = 0.0
    for _ in range(reweightings):
        cost = _refit(b, flow, evidence, weight, inlier, known, information, w, r2)
        scale = max(inlier**2, 2 * float(np.median(r2[usable])))
        weight = 1 / (1 + r2 / scale) ** 2
    return w, cost


@_compiled
def _refit(
    b: F64, flow: F64, evidence: F64, weight: F64, inlier: float, known: F64, information: F64,
    w: F64, r2: F64,
) -> float:  # fmt: skip
    """Fit a pure rotation w (3,) by weighted least squares, and return its robust cost.

    w and the squares (nodes,) of what it leaves of the flow are written.
    """
    matrix, vector = information.copy(), information @ known
    for n in range(len(flow)):
        for i in range(3):
            px = b[n, 0, i] * evidence[n, 0, 0] + b[n, 1, i] * evidence[n, 0, 1]
            py = b[n, 0, i] * evidence[n, 0, 1] + b[n, 1, i] * evidence[n, 1, 1]
            vector[i] += weight[n] * (px * flow[n, 0] + py * flow[n, 1])
            for j in range(3):
                matrix[i, j] += weight[n] * (px * b[n, 0, j] + py * b[n, 1, j])
    w[0], w[1], w[2] = _solve(_regular(matrix), vector)
    cost = _surprise(w - known, information)
    for n in range(len(flow)):
        x, y = flow[n, 0], flow[n, 1]
        for j in range(3):
            x -= b[n, 0, j] * w[j]
            y -= b[n, 1, j] * w[j]
        r2[n] = x * x + y * y
        cost += _robust(x, y, evidence[n], inlier)
    return cost


@_compiled
def _surprise(apart: F64, information: F64) -> float:
    """Cost of a rotation that lies `apart` (3,) from what is known."""
    return float(apart @ (information @ apart))


@_compiled
def _robust(x: float, y: float, evidence: F64, inlier: float) -> float:
    """Geman-McClure cost of a residual (x, y) in px per window."""
    return _square(x, y, evidence) / (1 + (x * x + y * y) / (inlier * inlier))


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
