"""The contrast in numba: warp, vote, images of warped events and what the other parts draw.

Everything is in float32, positions in pixels of the sensor. `derivatives` has the derivatives.
Whole steps are one compiled call, because each call waits for the interpreter's lock where another
thread has it.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.field_kernels import material_derivative
from emoflow_ros.core.lattice.window_events import CellEvents
from emoflow_ros.core.numerics.jit import fast, njit
from emoflow_ros.core.numerics.smoothing import Taps, smooth

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

MARGIN = 7  # image pixels around the sensor, for warped events that leave it

_compiled, _inlined = fast(), fast(inline="always")


@_inlined
def warp_along(events: CellEvents, ref: float, flow: F32, per_px: F32) -> F32:
    """Warp events to the time `ref` along a flow, (2, N) px.

    Args:
        events: sorted by the cells of the flow's lattice.
        ref: reference time in [0, 1].
        flow: (columns, rows, 2, 2) px per window, at the window's start and end.
        per_px: (2,) lattice cells per pixel.
    """
    position = np.empty((2, len(events.s)), np.float32)
    acceleration = np.empty((flow.shape[0], flow.shape[1], 2), np.float32)
    material_derivative(flow, per_px, acceleration)
    warp(events, ref, flow, acceleration, position)
    return position


@_compiled
def draw(
    events: CellEvents, ref: float, flow: F32, per_px: F32, zoom: float, taps: Taps, image: F32
) -> float:
    """Draw the image of events warped along a flow, and return the sum of its squares.

    Args:
        events, ref, flow, per_px: as in `warp_along`.
        zoom: image pixels per pixel of the working image.
        taps: that smooth the image.
        image: (1, h, w), written.
    """
    position = warp_along(events, ref, flow, per_px)
    vote(position, events.weights, np.zeros(len(events.s), np.int32), zoom, image)
    smooth(image, taps)
    return sum_of_squares(image)


@_compiled
def draw_shifted(
    x: F32, y: F32, s: F32, weights: F32, flows: F32, zoom: float, taps: Taps, image: F32
) -> F32:
    """Draw events once for each constant flow, and return the sums of squares (n,).

    Args:
        x, y, s, weights: (N,) events.
        flows: (n, 2) px per window.
        zoom, taps, image: as in `draw`.
    """
    one_image = np.zeros(len(x), np.int32)
    squares = np.empty(len(flows), np.float32)
    for n in range(len(flows)):
        vote(shift(x, y, s, flows[n, 0], flows[n, 1]), weights, one_image, zoom, image)
        smooth(image, taps)
        squares[n] = sum_of_squares(image)
    return squares


@_inlined
def sum_of_squares(image: F32) -> float:
    """Add up the squares of an image of any shape."""
    total, values = np.float32(0), image.ravel()
    for k in range(len(values)):  # over indices: over values it is no vector instructions
        total += values[k] * values[k]
    return float(total)


@_inlined
def warp(events: CellEvents, ref: float, flow: F32, acceleration: F32, out: F32) -> None:
    """Warp events to the time `ref` along the flow, second order in time.

    x' = x + dt u(s, x) + dt^2 / 2 a(x) with dt = ref - s: one Taylor step of
    dx/ds = u(s, x), a being the flow's material derivative. Within a cell u(s, x) + dt / 2 a(x) is
    a polynomial in the place and linear in s.

    Args:
        events: sorted by the cells of the flow's lattice.
        ref: reference time in [0, 1].
        flow: (columns, rows, 2, 2) px per window, at the window's start and end.
        acceleration: (columns, rows, 2), px per window squared.
        out: (2, N) warped positions in px, written.
    """
    columns, rows = flow.shape[:2]
    middle, half = np.float32(ref), np.float32(0.5)
    start = flow[:, :, 0] + middle * half * acceleration  # what does not depend on s
    change = flow[:, :, 1] - flow[:, :, 0] - half * acceleration
    for c in range(columns - 1):
        for r in range(rows - 1):
            cell = c * (rows - 1) + r
            here = slice(events.begin[cell], events.begin[cell + 1])
            right, down, s = events.right[here], events.down[here], events.s[here]
            for d in range(2):
                a, a_x, a_y, a_xy = _bilinear(start, c, r, d)
                b, b_x, b_y, b_xy = _bilinear(change, c, r, d)
                came = events.x[here] if d == 0 else events.y[here]
                went = out[d, here]
                for k in range(len(went)):
                    x, y = right[k], down[k]
                    u = a + x * a_x + y * (a_y + x * a_xy)
                    u += s[k] * (b + x * b_x + y * (b_y + x * b_xy))
                    went[k] = came[k] + (middle - s[k]) * u


@_inlined
def _bilinear(nodes: F32, c: int, r: int, d: int) -> tuple[float, float, float, float]:
    """Coefficients of 1, x, y and x y of the interpolation in a cell.

    Args:
        nodes: (columns, rows, 2) values.
        c, r: column and row of the cell's first node.
        d: component, 0 or 1.
    """
    left, lower = nodes[c, r, d], nodes[c, r + 1, d]
    by_x, lower_by_x = nodes[c + 1, r, d] - left, nodes[c + 1, r + 1, d] - lower
    return left, by_x, lower - left, lower_by_x - by_x


@_inlined
def shift(x: F32, y: F32, s: F32, u: float, v: float) -> F32:
    """Warp events (N,) each to the middle by a constant flow, px per window; (2, N) px."""
    position = np.empty((2, len(x)), np.float32)
    by_x, by_y, middle = np.float32(u), np.float32(v), np.float32(0.5)
    for k in range(len(x)):
        position[0, k] = x[k] + (middle - s[k]) * by_x
        position[1, k] = y[k] + (middle - s[k]) * by_y
    return position


@_inlined
def vote(position: F32, weights: F32, part: I32, zoom: float, images: F32) -> None:
    """Add weighted events to images by bilinear voting; the images are cleared first.

    Args:
        position: (2, N) px of the working image; what lies outside the margin is left out.
        weights: (N,).
        part: (N,) the image of each event.
        zoom: image pixels per pixel of the working image.
        images: (parts, h, w), written.
    """
    _, h, w = images.shape
    images[:] = 0.0
    pixels = images.ravel()
    shift, per_px, one = np.float32(MARGIN + 0.5 * zoom - 0.5), np.float32(zoom), np.float32(1)
    right, down = np.uint64(1), np.uint64(w)  # indices without a sign cannot count from the end
    for k in range(len(weights)):
        px = position[0, k] * per_px + shift
        py = position[1, k] * per_px + shift
        if px >= 1 and py >= 1 and px < w - 2 and py < h - 2:
            i = np.int32(py)
            j = np.int32(px)
            fy = py - np.float32(i)
            fx = px - np.float32(j)
            below = weights[k] * fy
            above = weights[k] - below
            at = np.uint64((part[k] * h + i) * w + j)
            pixels[at] += above * (one - fx)
            pixels[at + right] += above * fx
            pixels[at + down] += below * (one - fx)
            pixels[at + down + right] += below * fx


@njit(nogil=True)
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
