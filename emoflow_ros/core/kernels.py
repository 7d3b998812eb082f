"""The hot path: warp, vote and smoothing, in numba. What follows is in `derivatives`.

Positions are in pixels of the sensor, times s in [0, 1] over the window, lattice values in
px per window. Images have a margin, so that events warped across the border still count.
The tests hold slow references: autograd for the gradient, sums over pairs for the band.
"""

import numba
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

MARGIN = 12  # px of the sensor around the image of warped events
REACH = 6  # px of an image on either side of the middle of a smoothing kernel, at most

_fast = numba.njit(cache=True, fastmath=True, nogil=True)


@_fast
def cell_of(position: float, cells: int) -> tuple[int, float]:
    """Split a lattice coordinate into the cell's index and the fraction inside it."""
    cell = min(np.int32(position), np.int32(cells - 1))
    return cell, position - np.float32(cell)  # type: ignore[return-value]  # stays float32


@_fast
def warp(
    x: F32, y: F32, s: F32, ref: float, flow: F32, acceleration: F32, per_px: F32, out: F32
) -> None:
    """Warp events to the time `ref` along the flow, second order in time.

    x' = x + dt u(s, x) + dt^2 / 2 a(x) with dt = ref - s: one Taylor step of
    dx/ds = u(s, x), a being the flow's material derivative.

    Args:
        x, y, s: (N,) events.
        ref: reference time in [0, 1].
        flow: (columns, rows, times, 2).
        acceleration: (columns, rows, 2), px per window squared.
        per_px: (2,) lattice cells per pixel in x and y.
        out: (2, N) warped positions in px, written.
    """
    columns, rows, times, _ = flow.shape
    cells = times - 1
    one, half, middle = np.float32(1), np.float32(0.5), np.float32(ref)
    # Side by side what an event takes from a node: u, its change within the cell in time, a / 2
    nodes = np.empty((cells, columns, rows, 3, 2), np.float32)
    for q in range(cells):
        nodes[q, :, :, 0] = flow[:, :, q]
        nodes[q, :, :, 1] = flow[:, :, q + 1] - flow[:, :, q]
        nodes[q, :, :, 2] = half * acceleration
    values = nodes.ravel()
    down, right = np.uint64(6), np.uint64(6 * rows)  # without a sign: see `derivatives.pull`
    for k in range(len(x)):
        c, fx = cell_of(x[k] * per_px[0], columns - 1)
        r, fy = cell_of(y[k] * per_px[1], rows - 1)
        q, ft = cell_of(s[k] * np.float32(cells), cells)
        dt = middle - s[k]
        w11 = fx * fy
        w00, w01, w10 = one - fx - fy + w11, fy - w11, fx - w11
        at = np.uint64(6 * ((q * columns + c) * rows + r))
        for d in range(2):
            moved = np.float32(0)
            for node, weight in ((at, w00), (at + down, w01), (at + right, w10),
                                 (at + down + right, w11)):  # fmt: skip
                n = node + np.uint64(d)
                u = values[n] + ft * values[n + np.uint64(2)]
                moved += weight * (u + dt * values[n + np.uint64(4)])
            out[d, k] = dt * moved
        out[0, k] += x[k]
        out[1, k] += y[k]


@_fast
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


@_fast
def vote(position: F32, weights: F32, scale: float, images: F32) -> None:
    """Add weighted events to images by bilinear voting; the images are cleared first.

    Args:
        position: (2, N) px of the sensor; what lies outside the margin is left out.
        weights: (N,).
        scale: image pixels per sensor pixel.
        images: (parts, h, w), written: one for each part of the events, which are parts of equal
            numbers in the events' order.
    """
    parts, h, w = images.shape
    images[:] = 0.0
    shift, zoom, one = np.float32((MARGIN + 0.5) * scale - 0.5), np.float32(scale), np.float32(1)
    right, down = np.uint64(1), np.uint64(w)
    events = position.shape[1]
    for part in range(parts):
        image = images[part].ravel()
        for k in range(part * events // parts, (part + 1) * events // parts):
            px = position[0, k] * zoom + shift
            py = position[1, k] * zoom + shift
            if px >= 1 and py >= 1 and px < w - 2 and py < h - 2:
                i = np.int32(py)
                j = np.int32(px)
                fy = py - np.float32(i)
                fx = px - np.float32(j)
                below = weights[k] * fy
                above = weights[k] - below
                at = np.uint64(i * w + j)
                image[at] += above * (one - fx)
                image[at + right] += above * fx
                image[at + down] += below * (one - fx)
                image[at + down + right] += below * fx


@numba.njit(cache=True, nogil=True)
def without_own(images: F32) -> None:
    """Replace each of the images (parts, h, w) by the sum of the others, in place."""
    parts, h, w = images.shape
    total = np.empty(w, np.float32)
    for i in range(h):
        for j in range(w):
            total[j] = images[0, i, j]
        for part in range(1, parts):
            for j in range(w):
                total[j] += images[part, i, j]
        for part in range(parts):
            for j in range(w):
                images[part, i, j] = total[j] - images[part, i, j]


@_fast
def smooth(image: F32, taps: F32) -> None:
    """Convolve an image with a symmetric kernel along columns and rows, in place; zero outside.

    Args:
        image: (h, w).
        taps: (REACH + 1,) from the middle outwards: always as many, so that the loops over them
            are unrolled.
    """
    h, w = image.shape
    padded = np.zeros((h + 2 * REACH, w), np.float32)
    padded[REACH:-REACH] = image
    row = np.zeros(w + 2 * REACH, np.float32)
    for i in range(h):
        for j in range(w):
            total = taps[0] * padded[i + REACH, j]
            for k in range(1, REACH + 1):
                total += taps[k] * (padded[i + REACH - k, j] + padded[i + REACH + k, j])
            row[j + REACH] = total
        for j in range(w):
            total = taps[0] * row[j + REACH]
            for k in range(1, REACH + 1):
                total += taps[k] * (row[j + REACH - k] + row[j + REACH + k])
            image[i, j] = total
