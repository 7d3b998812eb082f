"""The contrast's gradient and curvature on the lattice, in numba; see `kernels`.

The sums over a cell's events stay in registers. Loops that write nothing else become vector
instructions, reads from the image included.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.kernels import MARGIN, vote, warp_along, without_own
from emoflow_ros.core.lattice.window_events import PAIRS, CellEvents
from emoflow_ros.core.numerics.jit import fast
from emoflow_ros.core.numerics.smoothing import Taps, smooth

F32 = NDArray[np.float32]

_inlined = fast(inline="always")

# Coefficients of 1, f and f^2 in the products of two hats: (1 - f)^2, (1 - f) f and f^2
_SQUARE = np.array([(1, -2, 1), (0, 1, -1), (0, 0, 1)], np.float32)


@fast()
def linearise(
    events: CellEvents, ref: float, flow: F32, per_px: F32, zoom: float, taps: Taps, stride: int,
    images: F32, gradient: F32, curvature: F32,
) -> None:  # fmt: skip
    """Warp and draw events, and differentiate their contrast: see `contrast.Contrast.linearise`.

    Args:
        events, ref, flow, per_px: as in `kernels.warp_along`.
        zoom, taps: as in `kernels.draw`.
        stride: events per event whose stiffness is computed.
        images: (parts, h, w), written: what the other parts draw.
        gradient, curvature: of Cells, written.
    """
    slope = zoom * zoom * PAIRS
    position = warp_along(events, ref, flow, per_px)
    vote(position, events.weights, events.part, zoom, images)
    smooth(images, taps)
    without_own(images)
    pull(events, ref, position, images, zoom, slope, gradient)
    stiffen(events, ref, position, images, zoom, stride, slope * PAIRS, curvature)


@_inlined
def pull(
    events: CellEvents,
    ref: float,
    position: F32,
    potentials: F32,
    zoom: float,
    factor: float,
    gradient: F32,
) -> None:
    """Sum the events' pulls on the nodes of each lattice cell.

    An event at x' climbs the potential: its gradient is that of the bilinear interpolant, so that
    the sum is the exact derivative of the contrast, but for (u . grad) u in the warp.

    Args:
        events: as they were voted.
        ref, position: the reference time and the (2, N) positions warped to it.
        potentials: (parts, h, w), one for each part of the events; see `contrast.Contrast`.
        zoom: image pixels per pixel of the working image.
        factor: of the sums.
        gradient: of Cells, written.
    """
    _, h, w = potentials.shape
    values, (cells_x, cells_y) = potentials.ravel(), gradient.shape[:2]
    one, half, nothing = np.float32(1), np.float32(0.5), np.float32(0)
    shift = np.float32(MARGIN + 0.5 * zoom - 0.5)
    per_px, middle = np.float32(zoom), np.float32(ref)
    last_x, last_y = np.float32(w - 2), np.float32(h - 2)
    below, down = np.int32(w), np.uint32(w)
    size, next_one = np.int32(h * w), np.uint32(1)  # without a sign: see `kernels.vote`
    for cell in range(cells_x * cells_y):
        here = slice(events.begin[cell], events.begin[cell + 1])
        x, y, part = position[0, here], position[1, here], events.part[here]
        s, weights = events.s[here], events.weights[here]
        to_right, to_bottom = events.right[here], events.down[here]
        x0 = x1 = x2 = x3 = x4 = x5 = x6 = x7 = nothing
        y0 = y1 = y2 = y3 = y4 = y5 = y6 = y7 = nothing
        for k in range(len(s)):
            px, py = x[k] * per_px + shift, y[k] * per_px + shift
            inside = (px >= one) & (py >= one) & (px < last_x) & (py < last_y)
            px, py = px if inside else one, py if inside else one
            i, j = np.int32(py), np.int32(px)
            fx, fy = px - np.float32(j), py - np.float32(i)
            at = np.uint32(part[k] * size + i * below + j)
            p00, p01 = values[at], values[at + next_one]
            p10, p11 = values[at + down], values[at + down + next_one]
            lever = weights[k] * (middle - s[k]) * per_px if inside else nothing
            gx = lever * ((one - fy) * (p01 - p00) + fy * (p11 - p10))
            gy = lever * ((one - fx) * (p10 - p00) + fx * (p11 - p01))
            # The change in time acts through the acceleration, too: as at half the way to `ref`.
            late = half * (s[k] + middle)
            gx_late, gy_late = gx * late, gy * late
            gx, gy = gx - gx_late, gy - gy_late
            h11 = to_right[k] * to_bottom[k]
            h10, h01 = to_right[k] - h11, to_bottom[k] - h11
            h00 = one - to_right[k] - h01
            x0, x1, x2, x3 = x0 + gx * h00, x1 + gx_late * h00, x2 + gx * h01, x3 + gx_late * h01
            x4, x5, x6, x7 = x4 + gx * h10, x5 + gx_late * h10, x6 + gx * h11, x7 + gx_late * h11
            y0, y1, y2, y3 = y0 + gy * h00, y1 + gy_late * h00, y2 + gy * h01, y3 + gy_late * h01
            y4, y5, y6, y7 = y4 + gy * h10, y5 + gy_late * h10, y6 + gy * h11, y7 + gy_late * h11
        sums = (x0, x1, x2, x3, x4, x5, x6, x7, y0, y1, y2, y3, y4, y5, y6, y7)
        pulls = gradient[cell // cells_y, cell % cells_y]
        for b in range(16):
            pulls[b >> 3, b & 7] = np.float32(factor) * sums[b]


@_inlined
def stiffen(
    events: CellEvents,
    ref: float,
    position: F32,
    potentials: F32,
    zoom: float,
    stride: int,
    factor: float,
    curvature: F32,
) -> None:
    """Sum the stiffness of each cell's events, from each stride-th of them.

    It is the potential's negative Hessian at x', cut to its positive semidefinite part.

    Args:
        events, ref, position, potentials, zoom: as in `pull`.
        stride: the events that are taken count this many times.
        factor: of the sums.
        curvature: of Cells, written.
    """
    _, h, w = potentials.shape
    values, (cells_x, cells_y) = potentials.ravel(), curvature.shape[:2]
    one, two, nothing, least = np.float32(1), np.float32(2), np.float32(0), np.float32(1e-20)
    half, quarter = np.float32(0.5), np.float32(0.25)
    shift = np.float32(MARGIN + 0.5 * zoom - 0.5)
    per_px, middle, share = np.float32(zoom), np.float32(ref), np.float32(factor * stride)
    last_x, last_y = np.float32(w - 2), np.float32(h - 2)
    below, size = np.int32(w), np.int32(h * w)
    right, down = np.uint32(1), np.uint32(w)
    most = -(-len(events.s) // stride)
    xx, xy, yy = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
    fx, fy, ft = np.empty(most, np.float32), np.empty(most, np.float32), np.empty(most, np.float32)
    for cell in range(cells_x * cells_y):
        # Sorted by time: in each cell another one comes first, so that no time counts more.
        first, end = events.begin[cell] + cell % stride, events.begin[cell + 1]
        number = max(0, -(-(end - first) // stride))
        chosen = slice(first, end, stride)
        s, weights, part = events.s[chosen], events.weights[chosen], events.part[chosen]
        x, y = position[0, chosen], position[1, chosen]
        to_right, to_bottom = events.right[chosen], events.down[chosen]
        for n in range(number):
            fx[n], fy[n], ft[n] = to_right[n], to_bottom[n], half * (s[n] + middle)
            px, py = x[n] * per_px + shift, y[n] * per_px + shift
            inside = (px >= one) & (py >= one) & (px < last_x) & (py < last_y)
            px, py = px if inside else one, py if inside else one
            dt = (middle - s[n]) * per_px
            lever = weights[n] * dt * dt * share if inside else nothing
            i, j = np.int32(py + half), np.int32(px + half)
            at = np.uint32(part[n] * size + i * below + j)
            twice = two * values[at]
            a = lever * (twice - values[at - right] - values[at + right])
            c = lever * (twice - values[at - down] - values[at + down])
            b = (quarter * lever) * (
                values[at - down + right]
                + values[at + down - right]
                - values[at - down - right]
                - values[at + down + right]
            )
            mean, skew = half * (a + c), half * (a - c)
            root = np.sqrt(skew * skew + b * b)
            cut = mean < root  # one eigenvalue, or both, below zero
            larger = mean + root if mean + root > nothing else nothing
            keep = half * larger / (root if root > least else least)
            xx[n] = keep * (root + skew) if cut else a
            xy[n] = keep * b if cut else b
            yy[n] = keep * (root - skew) if cut else c
        products = curvature[cell // cells_y, cell % cells_y]
        _sum_products(xx[:number], xy[:number], yy[:number], fx, fy, ft, products)


@_inlined
def _sum_products(xx: F32, xy: F32, yy: F32, fx: F32, fy: F32, ft: F32, sums: F32) -> None:
    """Sum (xx, xy, yy) times the 27 products of two nodes' weights, into (27, 3)."""
    one, nothing = np.float32(1), np.float32(0)
    for q in range(9):
        y0, y1, y2 = _SQUARE[q // 3, 0], _SQUARE[q // 3, 1], _SQUARE[q // 3, 2]
        t0, t1, t2 = _SQUARE[q % 3, 0], _SQUARE[q % 3, 1], _SQUARE[q % 3, 2]
        a0 = a1 = a2 = b0 = b1 = b2 = c0 = c1 = c2 = nothing
        for n in range(len(xx)):
            weight = (y0 + fy[n] * (y1 + fy[n] * y2)) * (t0 + ft[n] * (t1 + ft[n] * t2))
            left, right = one - fx[n], fx[n]
            p0, p1, p2 = weight * left * left, weight * left * right, weight * right * right
            a0, a1, a2 = a0 + xx[n] * p0, a1 + xx[n] * p1, a2 + xx[n] * p2
            b0, b1, b2 = b0 + xy[n] * p0, b1 + xy[n] * p1, b2 + xy[n] * p2
            c0, c1, c2 = c0 + yy[n] * p0, c1 + yy[n] * p1, c2 + yy[n] * p2
        for d, (by_0, by_1, by_2) in enumerate(((a0, a1, a2), (b0, b1, b2), (c0, c1, c2))):
            sums[q, d], sums[9 + q, d], sums[18 + q, d] = by_0, by_1, by_2
