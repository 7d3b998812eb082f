"""Compiled loops that cut patches out and find them again."""

import math

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import fast

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Share of the larger information below which the smaller one may be chance: an edge.
EDGE = 0.15
INDEPENDENT = 0.25  # share of a patch's residuals that are independent of each other

_compiled, _inlined = fast(), fast(inline="always")


@_compiled
def cut(image: F32, points: F64, radius: int) -> F32:
    """Cut patches (N, 2 radius + 1, 2 radius + 1) around points (N, 2), zero off the image."""
    side = 2 * radius + 1
    out = np.zeros((len(points), side, side), np.float32)
    for n in range(len(points)):
        _sample(image, points[n, 0] - radius, points[n, 1] - radius, out[n])
    return out


@_inlined
def _sample(image: F32, left: float, top: float, out: F32) -> None:
    """Sample an image bilinearly at whole steps from (left, top) on; zero off the image."""
    h, w = image.shape
    side = out.shape[0]
    i0, j0 = math.floor(top), math.floor(left)
    f, g = np.float32(left - j0), np.float32(top - i0)
    h11 = f * g
    h10, h01 = f - h11, g - h11
    h00 = np.float32(1) - f - h01
    if i0 < 0 or j0 < 0 or i0 + side >= h or j0 + side >= w:
        for i in range(side):
            for j in range(side):
                y, x = i0 + i, j0 + j
                if y < 0 or x < 0 or y + 1 >= h or x + 1 >= w:
                    out[i, j] = np.float32(0)
                else:
                    out[i, j] = h00 * image[y, x] + h10 * image[y, x + 1]
                    out[i, j] += h01 * image[y + 1, x] + h11 * image[y + 1, x + 1]
        return
    for i in range(side):
        upper, lower = image[i0 + i], image[i0 + i + 1]
        for j in range(side):
            k = j0 + j
            out[i, j] = (h00 * upper[k] + h10 * upper[k + 1]) + (
                h01 * lower[k] + h11 * lower[k + 1]
            )


@_compiled
def align(
    templates: F32, image: F32, along_x: F32, along_y: F32,
    start: F64, reach: float, steps: int, position: F64, information: F64, correlation: F64,
) -> None:  # fmt: skip
    """Shift each template to where it fits an image best: Gauss-Newton with a free gain.

    Minimises sum W (g T - J(x + p))^2 over p and the gain g, W a Gaussian of 0.6 of the patch's
    radius, along the slopes of the template (inverse compositional: Baker and Matthews, IJCV
    2004). Where these are an edge, what lies along it may be chance: noise would let the template
    slide.

    Args:
        templates: (N, side, side).
        image, along_x, along_y: (h, w) the image and its slopes.
        start: (N, 2) px, where each template's middle is expected.
        reach: standard deviation of that, px: along an edge a template stays there.
        steps: at most.
        position: (N, 2) px, written.
        information: (N, 2, 2) px^-2 of the position, by the residual's variance, written.
        correlation: (N,) normalised, in [-1, 1], written.
    """
    side = templates.shape[1]
    radius = side // 2
    weights = np.empty((side, side), np.float32)
    total = np.float32(0)
    for i in range(side):
        for j in range(side):
            squared = (i - radius) * (i - radius) + (j - radius) * (j - radius)
            weights[i, j] = np.float32(math.exp(-squared / (0.72 * radius * radius)))
            total += weights[i, j]
    now, slope_x, slope_y, weighted, by_x, by_y = np.empty((6, side, side), np.float32)
    for n in range(len(templates)):
        template = templates[n]
        x, y = start[n, 0], start[n, 1]
        squares, tx, ty, p, q, r = _weighted(template, weights, weighted, by_x, by_y)
        steep, flat, shown, ux, uy = _axes(float(p), float(q), float(r), EDGE)
        for _ in range(steps if steep > 0 else 0):
            _sample(image, x - radius, y - radius, now)
            product, power, jx, jy = _compared(now, weights, weighted, by_x, by_y)
            gain = min(max(product / squares, np.float32(0.05)), np.float32(20))
            e = max(power - gain * (2 * product - gain * squares), np.float32(1e-9))
            e = e / (total * np.float32(INDEPENDENT * reach * reach))
            rx, ry = gain * (gain * tx - jx), gain * (gain * ty - jy)
            back_x, back_y = e * (start[n, 0] - x), e * (start[n, 1] - y)
            across = (ux * (rx + back_x) + uy * (ry + back_y)) / (gain * gain * steep + e)
            along = shown * (ux * ry - uy * rx) + ux * back_y - uy * back_x
            along /= gain * gain * flat + e
            dx, dy = across * ux - along * uy, across * uy + along * ux
            length = math.sqrt(dx * dx + dy * dy)
            if length > 1.5:
                dx, dy = dx * 1.5 / length, dy * 1.5 / length
            x, y = x + dx, y + dy
            if length < 0.02:
                break
        _sample(image, x - radius, y - radius, now)
        _sample(along_x, x - radius, y - radius, slope_x)
        _sample(along_y, x - radius, y - radius, slope_y)
        position[n, 0], position[n, 1] = x, y
        correlation[n] = _judge(
            template, now, slope_x, slope_y, weights, total, squares, information[n]
        )


@_inlined
def _judge(
    template: F32, now: F32, slope_x: F32, slope_y: F32, weights: F32, total: np.float32,
    squares: np.float32, information: F64,
) -> float:  # fmt: skip
    """Write the information on a patch's place, and return its correlation.

    With the slopes S of what both images show and J' of the new one with its noise, a place that
    minimises the squares has the covariance (S S)^-1 (sigma^2 J' J') (S S)^-1. The noise of two
    slices is independent, so that S S is the mean of T' J': along an edge it vanishes, where
    J' J' does not.
    """
    product, power = np.float32(0), np.float32(1e-9)
    a = b = c = p = q = r = np.float32(0)
    side = template.shape[0]
    half = np.float32(0.5)
    for i in range(side):
        for j in range(side):
            w, t, value = weights[i, j], template[i, j], now[i, j]
            product += w * t * value
            power += w * value * value
            if 0 < i < side - 1 and 0 < j < side - 1:
                jx, jy = slope_x[i, j], slope_y[i, j]
                tx = half * (template[i, j + 1] - template[i, j - 1])
                ty = half * (template[i + 1, j] - template[i - 1, j])
                a += w * jx * jx
                b += w * jx * jy
                c += w * jy * jy
                p += w * tx * jx
                q += w * half * (tx * jy + ty * jx)
                r += w * ty * jy
    gain = product / squares
    variance = max(power - gain * product, np.float32(1e-6) * power) / total
    high, low, _, ux, uy = _axes(float(gain * p), float(gain * q), float(gain * r), EDGE)
    xx, yy = high * ux * ux + low * uy * uy, high * uy * uy + low * ux * ux
    xy = (high - low) * ux * uy
    det = max(float(a * c - b * b) * float(variance), 1e-12)
    # S (J' J')^-1 S
    m00, m01 = (xx * c - xy * b) / det, (xy * a - xx * b) / det
    m10, m11 = (xy * c - yy * b) / det, (yy * a - xy * b) / det
    information[0, 0] = m00 * xx + m01 * xy
    information[0, 1] = information[1, 0] = m00 * xy + m01 * yy
    information[1, 1] = m10 * xy + m11 * yy
    return float(product) / math.sqrt(squares * power)


@_inlined
def _axes(p: float, q: float, r: float, chance: float) -> tuple[float, float, float, float, float]:
    """Principal axes of products of slopes [p, q; q, r].

    Returns:
        The larger value; the smaller one less a share of the larger one, which may be chance; the
        share of it that is left; and the unit vector (x, y) of the larger one, across an edge.
    """
    mean, half = 0.5 * (p + r), 0.5 * (p - r)
    apart = math.sqrt(half * half + q * q)
    high, low = max(mean + apart, 0.0), mean - apart
    left = max(low - chance * high, 0.0)
    angle = 0.5 * math.atan2(2 * q, p - r)
    return high, left, left / low if left > 0 else 0.0, math.cos(angle), math.sin(angle)


@_inlined
def _weighted(
    template: F32, weights: F32, weighted: F32, by_x: F32, by_y: F32
) -> tuple[np.float32, ...]:
    """Write W T, W T'x and W T'y of a template T; return sums of W times TT, T T', T' T'."""
    squares, half = np.float32(1e-9), np.float32(0.5)
    tx = ty = p = q = r = np.float32(0)
    side = template.shape[0]
    by_x[:], by_y[:] = 0, 0
    for i in range(side):
        for j in range(side):
            w, t = weights[i, j], template[i, j]
            weighted[i, j] = w * t
            squares += w * t * t
            if 0 < i < side - 1 and 0 < j < side - 1:
                sx = half * (template[i, j + 1] - template[i, j - 1])
                sy = half * (template[i + 1, j] - template[i - 1, j])
                by_x[i, j], by_y[i, j] = w * sx, w * sy
                tx += w * sx * t
                ty += w * sy * t
                p += w * sx * sx
                q += w * sx * sy
                r += w * sy * sy
    return squares, tx, ty, p, q, r


@_inlined
def _compared(
    now: F32, weights: F32, weighted: F32, by_x: F32, by_y: F32
) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Sums of T J, J J, T'x J and T'y J, with weights as `_weighted` writes them."""
    product, power = np.float32(0), np.float32(1e-9)
    jx = jy = np.float32(0)
    side = now.shape[0]
    for i in range(side):
        for j in range(side):
            value = now[i, j]
            product += weighted[i, j] * value
            power += weights[i, j] * value * value
            jx += by_x[i, j] * value
            jy += by_y[i, j] * value
    return product, power, jx, jy
