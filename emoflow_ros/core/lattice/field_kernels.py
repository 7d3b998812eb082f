"""Inner loops of the lattice in numba: its field between the nodes, along its own motion."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import fast, njit

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@njit(nogil=True)
def advance(
    flow: F32, points: NDArray[np.float64], start: float, end: float, steps: int, per_px: F32
) -> NDArray[np.float64]:
    """Carry points (N, 2) px along a field by the midpoint method; see `Lattice.advance`."""
    h = (end - start) / steps
    x, y = points[:, 0].astype(np.float32), points[:, 1].astype(np.float32)
    moved, halfway = np.zeros((2, len(x)), np.float32), np.empty((2, len(x)), np.float32)
    for k in range(steps):
        s = start + k * h
        _step(at_time(flow, s), per_px, x, y, moved, moved, 0.5 * h, halfway)
        _step(at_time(flow, s + 0.5 * h), per_px, x, y, halfway, moved, h, moved)
    out = np.empty_like(points)
    for i in range(len(points)):
        known = np.isfinite(points[i, 0]) and np.isfinite(points[i, 1])
        for d in range(2):
            out[i, d] = points[i, d] + moved[d, i] if known else np.nan
    return out


@njit(nogil=True)
def _step(still: F32, per_px: F32, x: F32, y: F32, at: F32, begin: F32, h: float, out: F32) -> None:
    """Take one step of points: out = begin + h times the field at (x, y) + at.

    Displacements are in float32, and columns apart from rows: twice as fast as points in float64.

    Args:
        still: (columns, rows, 2) the field, constant beyond its border.
        per_px: cells per pixel in x and y.
        x, y: (N,) px.
        at, begin, out: (2, N) px; `out` is written and may be `begin`.
        h: length of the step.
    """
    columns, rows = still.shape[:2]
    nodes = np.ascontiguousarray(still).ravel()
    zero, one, share = np.float32(0), np.float32(1), np.float32(h)
    last_x, last_y = np.float32(columns - 1), np.float32(rows - 1)
    last_column, last_row = np.int32(columns - 2), np.int32(rows - 2)
    u, v = np.uint32(0), np.uint32(1)  # indices without a sign cannot count from the end
    down, right = np.uint32(2), np.uint32(2 * rows)
    for i in range(len(x)):
        px, py = (x[i] + at[0, i]) * per_px[0], (y[i] + at[1, i]) * per_px[1]
        px, py = px if px > zero else zero, py if py > zero else zero  # NaN becomes 0, too
        px, py = px if px < last_x else last_x, py if py < last_y else last_y
        c, r = min(np.int32(px), last_column), min(np.int32(py), last_row)
        a, b = px - np.float32(c), py - np.float32(r)
        h11 = a * b
        h10, h01 = a - h11, b - h11
        h00 = one - a - h01
        for d, component in ((0, u), (1, v)):
            node = np.uint32(np.int32(2) * (c * np.int32(rows) + r)) + component
            left = h00 * nodes[node] + h01 * nodes[node + down]
            step = left + h10 * nodes[node + right] + h11 * nodes[node + right + down]
            out[d, i] = begin[d, i] + share * step


@njit(nogil=True)
def at_time(flow: F32, s: float) -> F32:
    """Interpolate a field in time; see `Lattice.at_time`."""
    last = flow.shape[2] - 1
    at = min(1.0, max(0.0, s)) * last
    q = min(int(at), last - 1)
    return flow[:, :, q] + np.float32(at - q) * (flow[:, :, q + 1] - flow[:, :, q])


@njit(nogil=True)
def bilinear(grid: F64, points: F64, per_px: F32) -> F64:
    """Interpolate a grid (columns, rows, n) at points (N, 2) px, constant beyond its border.

    Args:
        grid: the values at the nodes.
        points: x and y; a point that is not finite gets NaN.
        per_px: cells per pixel in x and y.

    Returns:
        (N, n).
    """
    columns, rows, number = grid.shape
    out = np.empty((len(points), number))
    for i in range(len(points)):
        x, y = points[i, 0] * per_px[0], points[i, 1] * per_px[1]
        if not (np.isfinite(x) and np.isfinite(y)):
            out[i] = np.nan
            continue
        x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
        c, r = min(int(x), columns - 2), min(int(y), rows - 2)
        a, b = x - c, y - r
        for d in range(number):
            left = (1 - b) * grid[c, r, d] + b * grid[c, r + 1, d]
            right = (1 - b) * grid[c + 1, r, d] + b * grid[c + 1, r + 1, d]
            out[i, d] = (1 - a) * left + a * right
    return out


@fast(inline="always")
def material_derivative(flow: F32, per_px: F32, out: F32) -> None:
    """Differentiate a field along its own motion, du/ds + (u . grad) u, over the whole window.

    Central differences of the mean in space, one-sided at the border.

    Args:
        flow: (columns, rows, times, 2) px per window.
        per_px: (2,) lattice cells per pixel in x and y.
        out: (columns, rows, 2) px per window squared, written.
    """
    columns, rows, times, _ = flow.shape
    mean = np.zeros((columns, rows, 2), np.float32)
    for q in range(times):
        mean += flow[:, :, q] / np.float32(times)
    for c in range(columns):
        before, after = max(c - 1, 0), min(c + 1, columns - 1)
        per_x = per_px[0] / np.float32(after - before)
        for r in range(rows):
            above, below = max(r - 1, 0), min(r + 1, rows - 1)
            per_y = per_px[1] / np.float32(below - above)
            for d in range(2):
                out[c, r, d] = (
                    flow[c, r, -1, d]
                    - flow[c, r, 0, d]
                    + mean[c, r, 0] * per_x * (mean[after, r, d] - mean[before, r, d])
                    + mean[c, r, 1] * per_y * (mean[c, below, d] - mean[c, above, d])
                )
