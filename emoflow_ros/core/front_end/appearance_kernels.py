"""Compiled loops that draw patches as the present flow shows them, and let them learn from it."""

import math

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import fast

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Index = NDArray[np.int64]

UNSEEN_PX = 0.2  # that a deformation moves a patch's border by, and need not be drawn

_compiled, _inlined = fast(), fast(inline="always")


@_compiled
def templates(slopes: F32, chosen: Index, toward: F64, shapes: F64) -> F32:
    """Draw what slopes show along u, as it looks once the offsets are multiplied by shapes.

    Where that moves the border by less than UNSEEN_PX offsets stay as they are.

    Args:
        slopes: (N, 2, side, side) along x and y; beyond their border the border's values go on.
        chosen: (M,) which of the patches.
        toward: (N, 2) u.
        shapes: (N, 2, 2), of a determinant above zero.

    Returns:
        (M, side, side).
    """
    side = slopes.shape[2]
    out = np.empty((len(chosen), side, side), np.float32)
    shown = np.empty((side, side), np.float32)
    radius = side // 2
    last = side - 1.001
    for m in range(len(chosen)):
        n = chosen[m]
        u, v = np.float32(toward[n, 0]), np.float32(toward[n, 1])
        for i in range(side):
            for j in range(side):
                shown[i, j] = u * slopes[n, 0, i, j] + v * slopes[n, 1, i, j]
        det = shapes[n, 0, 0] * shapes[n, 1, 1] - shapes[n, 0, 1] * shapes[n, 1, 0]
        a, b = shapes[n, 1, 1] / det, -shapes[n, 0, 1] / det
        c, d = -shapes[n, 1, 0] / det, shapes[n, 0, 0] / det
        same = (abs(a - 1) + abs(b) + abs(c) + abs(d - 1)) * radius < UNSEEN_PX
        for i in range(side):
            for j in range(side):
                if same:
                    out[m, i, j] = shown[i, j]
                    continue
                x = min(max(a * (j - radius) + b * (i - radius) + radius, 0.0), last)
                y = min(max(c * (j - radius) + d * (i - radius) + radius, 0.0), last)
                out[m, i, j] = _at(shown, x, y)
    return out


@_compiled
def cut_shaped(image: F32, points: F64, shapes: F64, radius: int) -> F32:
    """Cut patches (N, side, side), side = 2 radius + 1, whose offsets shapes have multiplied.

    NaN off the image.

    Args:
        image: (h, w).
        points: (N, 2) px of their middles.
        shapes: (N, 2, 2).
        radius: px.
    """
    h, w = image.shape
    side = 2 * radius + 1
    out = np.full((len(points), side, side), np.float32(np.nan))
    for n in range(len(points)):
        for i in range(side):
            for j in range(side):
                a, b = j - radius, i - radius
                x = points[n, 0] + shapes[n, 0, 0] * a + shapes[n, 0, 1] * b
                y = points[n, 1] + shapes[n, 1, 0] * a + shapes[n, 1, 1] * b
                if 0 <= x < w - 1 and 0 <= y < h - 1:
                    out[n, i, j] = _at(image, x, y)
    return out


@_compiled
def learn(
    slopes: F32, found: F32, first: F64, toward: F64, learning: float, correlation: float
) -> None:
    """Change slopes across the first flow by what is found along another one.

    Least mean squares (Widrow and Hoff, 1960).

    Args:
        slopes: (N, 2, side, side) that are known, changed.
        found: (N, side, side) events in the shape of the slopes; NaN where there are none.
        first: (N, 2) u of the first flow.
        toward: (N, 2) u of the present one.
        learning: step.
        correlation: least one of what is expected and found from which something is learnt.
    """
    side = slopes.shape[2]
    for n in range(len(slopes)):
        u, v = np.float32(toward[n, 0]), np.float32(toward[n, 1])
        both = power = strength = 0.0
        for i in range(side):
            for j in range(side):
                now = found[n, i, j]
                if not math.isnan(now):
                    expected = u * slopes[n, 0, i, j] + v * slopes[n, 1, i, j]
                    both += expected * now
                    power += expected * expected
                    strength += now * now
        if not both > correlation * math.sqrt(power * strength):
            continue
        gain = np.float32(power / both)
        sine = first[n, 0] * toward[n, 1] - first[n, 1] * toward[n, 0]
        by_x = np.float32(-learning * sine * first[n, 1])
        by_y = np.float32(learning * sine * first[n, 0])
        for i in range(side):
            for j in range(side):
                now = found[n, i, j]
                if not math.isnan(now):
                    error = gain * now - (u * slopes[n, 0, i, j] + v * slopes[n, 1, i, j])
                    slopes[n, 0, i, j] += by_x * error
                    slopes[n, 1, i, j] += by_y * error


@_inlined
def _at(image: F32, x: float, y: float) -> np.float32:
    """Value of an image at a point that is left of and above its last pixel, bilinear."""
    u, v = int(x), int(y)
    f, g, one = np.float32(x - u), np.float32(y - v), np.float32(1)
    upper = (one - f) * image[v, u] + f * image[v, u + 1]
    lower = (one - f) * image[v + 1, u] + f * image[v + 1, u + 1]
    return (one - g) * upper + g * lower
