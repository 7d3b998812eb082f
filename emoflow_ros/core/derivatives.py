"""The contrast's gradient and curvature on the lattice, in numba; see `kernels`.

What an event adds to its cell is written as loops over lanes, the entries of an array with a
coefficient for each. The compiler makes vector instructions of such loops. A loop over a cell's
eight nodes it would unroll instead.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.kernels import MARGIN, cell_of

F32 = NDArray[np.float32]
Cells = tuple[int, int, int]

_NODES = np.array([(a >> 2, a >> 1 & 1, a & 1) for a in range(8)])  # of a cell in x, y and time
# Products of two nodes' weights: 27 different ones, by the sum of the nodes' places.
_PAIR = (_NODES[:, None] + _NODES) @ (9, 3, 1)
_PAIRS = np.array([(n // 9, n // 3 % 3, n % 3) for n in range(27)])
_LANES = 32  # the 27, and five of zeros

# Coefficients (3, 2, 16) by dimension and power of a hat at the nodes, for x and y of the gradient
_HAT = np.tile(np.array([(1.0, -1.0), (0.0, 1.0)])[_NODES].transpose(1, 2, 0), 2)
_HAT = _HAT.astype(np.float32)
_OF_X = np.repeat(np.array([1.0, 0.0], np.float32), 8)
_OF_Y = 1 - _OF_X
# ... and (3, 3, 32) of the products of two: (1 - f)^2, (1 - f) f and f^2
_SQUARE = np.array([(1.0, -2.0, 1.0), (0.0, 1.0, -1.0), (0.0, 0.0, 1.0)])[_PAIRS].transpose(1, 2, 0)
_SQUARE = np.pad(_SQUARE, ((0, 0), (0, 0), (0, _LANES - 27))).astype(np.float32)

_fast = numba.njit(cache=True, fastmath=True, nogil=True)


@_fast
def _place(x: float, y: float, t: float, cells: Cells) -> tuple[int, float, float, float]:
    """Split a position on the lattice into the cell's index and the fractions inside it."""
    c, fx = cell_of(x, cells[0])
    r, fy = cell_of(y, cells[1])
    q, ft = cell_of(t, cells[2])
    cell = np.uint64((c * cells[1] + r) * cells[2] + q)  # without a sign: see `pull`
    return cell, fx, fy, ft  # type: ignore[return-value]


@_fast
def pull(
    x: F32,
    y: F32,
    s: F32,
    weights: F32,
    ref: float,
    position: F32,
    potentials: F32,
    scale: float,
    per_px: F32,
    gradient: F32,
) -> None:
    """Add each event's pull to its lattice cell.

    An event at x' climbs the potential: its gradient is that of the bilinear interpolant, so that
    the sum is the exact derivative of the contrast, but for (u . grad) u in the warp.

    Args:
        x, y, s, weights: (N,) events as they were voted.
        ref, position: the reference time and the (2, N) positions warped to it.
        potentials: (parts, h, w), one for each part of the events; see `contrast.Contrast`.
        scale: image pixels per sensor pixel.
        per_px: (2,) lattice cells per pixel.
        gradient: (columns - 1, rows - 1, times - 1, 2, 8), added to; the last axis counts
            the cell's nodes with time innermost and the column outermost.
    """
    parts, h, w = potentials.shape
    cells = (gradient.shape[0], gradient.shape[1], gradient.shape[2])
    pulls = gradient.reshape(-1, 16)
    one, half = np.float32(1), np.float32(0.5)
    shift = np.float32((MARGIN + 0.5) * scale - 0.5)
    zoom, middle = np.float32(scale), np.float32(ref)
    right, down = np.uint64(1), np.uint64(w)  # indices without a sign cannot count from the end
    events = len(x)
    for part in range(parts):
        potential = potentials[part].ravel()
        for k in range(part * events // parts, (part + 1) * events // parts):
            px = position[0, k] * zoom + shift
            py = position[1, k] * zoom + shift
            if not (px >= 1 and py >= 1 and px < w - 2 and py < h - 2):
                continue
            # The change in time acts through the acceleration, too: as at half the way to `ref`.
            t = half * (s[k] + middle) * cells[2]
            cell, tx, ty, tt = _place(x[k] * per_px[0], y[k] * per_px[1], t, cells)
            i = np.int32(py)
            j = np.int32(px)
            fy = py - np.float32(i)
            fx = px - np.float32(j)
            at = np.uint64(i * w + j)
            p00 = potential[at]
            p01 = potential[at + right]
            p10 = potential[at + down]
            p11 = potential[at + down + right]
            lever = weights[k] * (middle - s[k]) * zoom
            gx = lever * ((one - fy) * (p01 - p00) + fy * (p11 - p10))
            gy = lever * ((one - fx) * (p10 - p00) + fx * (p11 - p01))
            g = pulls[cell]
            for b in range(16):
                node = (
                    (_HAT[0, 0, b] + _HAT[0, 1, b] * tx)
                    * (_HAT[1, 0, b] + _HAT[1, 1, b] * ty)
                    * (_HAT[2, 0, b] + _HAT[2, 1, b] * tt)
                )
                g[b] += (_OF_X[b] * gx + _OF_Y[b] * gy) * node


@_fast
def stiffen(
    x: F32,
    y: F32,
    s: F32,
    weights: F32,
    ref: float,
    position: F32,
    potentials: F32,
    scale: float,
    per_px: F32,
    stride: int,
    curvature: F32,
) -> None:
    """Add the stiffness of each stride-th event to its lattice cell.

    It is the potential's negative Hessian at x', cut to its positive semidefinite part.

    Args:
        x, y, s, weights, ref, position, potentials, scale, per_px: as in `pull`.
        stride: the events that are taken count this many times.
        curvature: (columns - 1, rows - 1, times - 1, 8, 3, 8), added to: for each pair of nodes
            a >= b, the others are left alone, xx, xy, yy.
    """
    parts, h, w = potentials.shape
    cells = (curvature.shape[0], curvature.shape[1], curvature.shape[2])
    blocks = curvature.reshape(-1, 8, 3, 8)
    sums = np.zeros((len(blocks), 3, _LANES), np.float32)
    two, half, quarter = np.float32(2), np.float32(0.5), np.float32(0.25)
    shift = np.float32((MARGIN + 0.5) * scale - 0.5)
    zoom, middle = np.float32(scale), np.float32(ref)
    share = np.float32(stride)
    right, down = np.uint64(1), np.uint64(w)
    events = len(x)
    for part in range(parts):
        potential = potentials[part].ravel()
        first = -(-(part * events // parts) // stride) * stride
        for k in range(first, (part + 1) * events // parts, stride):
            px = position[0, k] * zoom + shift
            py = position[1, k] * zoom + shift
            if not (px >= 1 and py >= 1 and px < w - 2 and py < h - 2):
                continue
            t = half * (s[k] + middle) * cells[2]
            cell, fx, fy, ft = _place(x[k] * per_px[0], y[k] * per_px[1], t, cells)
            dt = (middle - s[k]) * zoom
            lever = weights[k] * dt * dt * share
            at = np.uint64(np.int32(py + half) * w + np.int32(px + half))
            twice = two * potential[at]
            xx = lever * (twice - potential[at - right] - potential[at + right])
            yy = lever * (twice - potential[at - down] - potential[at + down])
            xy = (quarter * lever) * (
                potential[at - down + right]
                + potential[at + down - right]
                - potential[at - down - right]
                - potential[at + down + right]
            )
            mean = half * (xx + yy)
            skew = half * (xx - yy)
            root = np.sqrt(skew * skew + xy * xy)
            if mean < root:  # one eigenvalue, or both, below zero
                keep = half * max(mean + root, np.float32(0)) / max(root, np.float32(1e-20))
                xx = keep * (root + skew)
                yy = keep * (root - skew)
                xy = keep * xy
            total = sums[cell]
            for b in range(_LANES):
                pair = (
                    (_SQUARE[0, 0, b] + fx * (_SQUARE[0, 1, b] + fx * _SQUARE[0, 2, b]))
                    * (_SQUARE[1, 0, b] + fy * (_SQUARE[1, 1, b] + fy * _SQUARE[1, 2, b]))
                    * (_SQUARE[2, 0, b] + ft * (_SQUARE[2, 1, b] + ft * _SQUARE[2, 2, b]))
                )
                total[0, b] += xx * pair
                total[1, b] += xy * pair
                total[2, b] += yy * pair
    for n in range(len(blocks)):
        for a in range(8):
            for b in range(a + 1):
                for d in range(3):
                    blocks[n, a, d, b] += sums[n, d, _PAIR[a, b]]
