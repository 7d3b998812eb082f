"""Compiled loops that draw slices."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import fast
from emoflow_ros.core.numerics.smoothing import Taps, smooth

F32 = NDArray[np.float32]

_compiled = fast()


@_compiled
def draw_signed(
    x: F32, y: F32, dt: F32, sign: F32, flow: F32, grid_px: int, width: int, height: int, taps: Taps
) -> F32:
    """Vote events, moved by dt along a flow, with their polarity into a smoothed image (h, w).

    Args:
        x, y: (N,) px.
        dt: (N,) s.
        sign: (N,).
        flow: (rows, columns, 2) px/s at nodes grid_px apart, linear beyond them.
        grid_px, width, height: px.
        taps: that smooth the image.
    """
    images = np.zeros((1, height, width), np.float32)
    image = images[0]
    rows, columns = flow.shape[:2]
    per_px = np.float32(1.0 / grid_px)
    for k in range(len(x)):
        a, b = x[k] * per_px, y[k] * per_px
        c, r = min(int(a), columns - 2), min(int(b), rows - 2)
        a, b = a - np.float32(c), b - np.float32(r)
        h11 = a * b
        h10, h01 = a - h11, b - h11
        h00 = np.float32(1) - a - h01
        u = h00 * flow[r, c, 0] + h10 * flow[r, c + 1, 0]
        u += h01 * flow[r + 1, c, 0] + h11 * flow[r + 1, c + 1, 0]
        v = h00 * flow[r, c, 1] + h10 * flow[r, c + 1, 1]
        v += h01 * flow[r + 1, c, 1] + h11 * flow[r + 1, c + 1, 1]
        px, py = x[k] + u * dt[k], y[k] + v * dt[k]
        if not (px >= 0 and py >= 0 and px < width - 1 and py < height - 1):
            continue
        i, j = int(py), int(px)
        f, g = px - np.float32(j), py - np.float32(i)
        s = sign[k]
        image[i, j] += s * (1 - f) * (1 - g)
        image[i, j + 1] += s * f * (1 - g)
        image[i + 1, j] += s * (1 - f) * g
        image[i + 1, j + 1] += s * f * g
    smooth(images, taps)
    return image


@_compiled
def halve(image: F32) -> F32:
    """Mean of each 2 x 2 pixels of an image, smoothed by [1 2 1] / 4 along both axes before."""
    h, w = image.shape
    out = np.zeros((h // 2, w // 2), np.float32)
    for i in range(1, h // 2 - 1):
        for j in range(1, w // 2 - 1):
            total = np.float32(0)
            for k in range(4):
                row = np.float32(0.125 if k == 0 or k == 3 else 0.375)
                line = image[2 * i - 1 + k]
                total += row * (
                    np.float32(0.125) * (line[2 * j - 1] + line[2 * j + 2])
                    + np.float32(0.375) * (line[2 * j] + line[2 * j + 1])
                )
            out[i, j] = total
    return out


@_compiled
def slope(image: F32) -> tuple[F32, F32]:
    """Central differences of an image along x and y, zero at the border."""
    h, w = image.shape
    along_x, along_y = np.zeros((h, w), np.float32), np.zeros((h, w), np.float32)
    half = np.float32(0.5)
    for i in range(1, h - 1):
        for j in range(1, w - 1):
            along_x[i, j] = half * (image[i, j + 1] - image[i, j - 1])
            along_y[i, j] = half * (image[i + 1, j] - image[i - 1, j])
    return along_x, along_y
