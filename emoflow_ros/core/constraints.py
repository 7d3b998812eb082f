"""Inner loops of the epipolar constraint on the lattice, in numba.

At a node with flow u, px per window, a motion (w, v) leaves the translational flow u - b w. It
ought to lie along the epipolar line l = a v of core.camera_motion, mapped through the lens to
pixels.
"""

import numba
import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_LEAST_FLOW_PX = 0.3  # flow, px per window, that cannot be told from zero

# Sums may be taken in any order, so that they become vector instructions.
_compiled = numba.njit(cache=True, fastmath={"reassoc", "contract", "arcp", "nsz"}, nogil=True)


@_compiled
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


@_compiled
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
def best_motion(
    flow: F64, evidence: F64, a: F64, b: F64, start: F64, soft: float, inlier: float,
    reweightings: int,
) -> tuple[F64, F64, F64]:  # fmt: skip
    """Fit a constant motion to a flow: robust least squares in the DEC.

    Args:
        flow: (nodes, 2) px per window.
        evidence: (nodes, 2, 2) inverse covariance of the flow; zero where it does not count.
        start: (3,) unit v to begin with, and w = 0.
        inlier: px per window, of the Geman-McClure weights.
        reweightings: least squares solutions.
        a, b, soft: as in `across_lines`.

    Returns:
        w (3,), v (3,) unit, and the information (6, 6) on both; v's length counts as known.
    """
    nodes = len(flow)
    r, normal, rows = np.empty((nodes, 1)), np.empty((nodes, 1, 2)), np.empty((nodes, 1, 7))
    once = np.expand_dims(flow, 1)
    w, v, matrix = np.zeros((1, 3)), start.copy().reshape(1, 3), np.eye(6)
    for _ in range(reweightings):
        across_lines(once, a, b, w, v, soft, r, normal, rows)
        matrix, vector = np.zeros((6, 6)), np.zeros(6)
        for n in range(nodes):
            weight = _square(normal[n, 0, 0], normal[n, 0, 1], evidence[n])
            weight /= (1 + (r[n, 0] / inlier) ** 2) ** 2
            for i in range(6):
                weighted = weight * rows[n, 0, i]
                vector[i] -= weighted * r[n, 0]
                for j in range(6):
                    matrix[i, j] += weighted * rows[n, 0, j]
        length = matrix[3, 3] + matrix[4, 4] + matrix[5, 5]
        for i in range(3):
            for j in range(3):
                matrix[3 + i, 3 + j] += length * v[0, i] * v[0, j]  # nobody knows v's length
        extent = 1e-9 * np.trace(matrix) + 1e-12
        for i in range(6):
            matrix[i, i] += extent
        step = np.linalg.solve(matrix, vector)
        w[0] += step[:3]
        v[0] += step[3:]
        v[0] /= np.sqrt(v[0] @ v[0])
    return w[0], v[0], matrix


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
def _chain(by_x: float, by_y: float, by_lx: float, by_ly: float, a: F64, b: F64, out: F64) -> None:
    """Chain derivatives by flow and line to those by w and v."""
    for j in range(3):
        out[j] = -(by_x * b[0, j] + by_y * b[1, j])
        out[3 + j] = by_lx * a[0, j] + by_ly * a[1, j]


@_compiled
def best_rotations(
    line: F64, soft: float, b: F64, flow: F64, evidence: F64, inlier: float, reweightings: int,
    known: F64, information: F64, depths: float, turns: float, px_per_rad: float,
    w: F64, residual: F64, size: F64,
) -> None:  # fmt: skip
    """Fit a rotation to each field of epipolar lines: robust least squares in n . (u - b w).

    n is the unit normal to the line. What of the scene would lie behind the camera costs its whole
    u - b w, not the part across the line alone: no depth explains it. v's sign is the one that
    makes this cheaper. The size of both parts of the flow has a cost of its own (docs/method.md):

        depths sum weight [ln(1 + e) + q^2 / (var (1 + e))] + turns ln(|w|^2 f^2 + least^2)

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
        depths: independent depths per node.
        turns: the power of |w| that a rotation's probability falls with.
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
        share, scale, turning = 0.0, 1.0, 0.0  # the first solution does not know any size
        for _ in range(reweightings):
            matrix, vector = information.copy(), information @ known
            _add_squares(weight * of_side, across, side, matrix, vector)
            if share > 0:
                of_size = share * weight * of_length / (1 + of_length * scale * squared)
                _add_squares(of_size, along, length, matrix, vector)
            for i in range(3):
                matrix[i, i] += turning
            w[m] = _solve(_regular(matrix), vector)
            w0, w1, w2 = w[m, 0], w[m, 1], w[m, 2]
            moved, reach = 0.0, 1e-9
            for n in range(nodes):
                r = side[n] - across[0, n] * w0 - across[1, n] * w1 - across[2, n] * w2
                q = length[n] - along[0, n] * w0 - along[1, n] * w1 - along[2, n] * w2
                inverse = 1 / (1 + (r / inlier) ** 2)
                weight[n] = inverse * inverse
                moved += weight[n] * of_length[n] * (q * q + _LEAST_FLOW_PX**2)
                reach += weight[n] * of_length[n] * squared[n]
            share, scale = depths, moved / reach
            turning = turns / (w[m] @ w[m] + (_LEAST_FLOW_PX / px_per_rad) ** 2)
        ahead, behind, sizes = 0.0, 0.0, 0.0
        for n in range(nodes):
            r, q = side[n], length[n]
            for j in range(3):
                r -= across[j, n] * w[m, j]
                q -= along[j, n] * w[m, j]
            beside = of_side[n] * r * r / (1 + (r / inlier) ** 2)
            lx, ly = line[m, n, 0] / np.sqrt(squared[n]), line[m, n, 1] / np.sqrt(squared[n])
            whole = _robust(lx * q - ly * r, ly * q + lx * r, evidence[n], inlier)
            ahead += beside if q > 0 else whole
            behind += whole if q > 0 else beside
            if depths > 0:
                excess = of_length[n] * scale * squared[n]
                sizes += weight[n] * (np.log(1 + excess) + of_length[n] * q * q / (1 + excess))
        residual[m] = min(ahead, behind) + _surprise(w[m] - known, information)
        size[m] = depths * sizes + turns * size_of_turn(w[m], px_per_rad)


@_compiled
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
def _solve(matrix: F64, vector: F64) -> F64:
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
    return np.array([(x - b * y - c * z) / a, y, z])


@_compiled
def size_of_turn(w: F64, px_per_rad: float) -> float:
    """Logarithm of the square of the flow, px, that a rotation w (3,) makes."""
    return float(np.log((w @ w) * px_per_rad**2 + _LEAST_FLOW_PX**2))


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
            cost += _robust(x, y, evidence[n], inlier)
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
