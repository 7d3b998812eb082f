"""Compiled loops that choose where an image has structure."""

import math

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import fast

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]

_compiled = fast()


def corners(score: F32, taken: F64, distance: int, border: int, least: float, most: int) -> F64:
    """Choose the highest scores that lie apart from each other and from points that are taken.

    Args:
        score: (h, w).
        taken: (N, 2) px.
        distance: least distance along x or y, px.
        border: width of the image's border without points, px.
        least: score of a point at least.
        most: number of points at most.

    Returns:
        (M, 2) px, M <= most, the highest score first.
    """
    free = _free(score, taken, distance, border)
    where, value = _peaks(score, free, border, least)
    return _chosen(where[np.argsort(-value, kind="stable")], free, distance, most)


@_compiled
def _free(score: F32, taken: F64, distance: int, border: int) -> Mask:
    """Mask (h, w) of where points may be chosen."""
    h, w = score.shape
    free = np.zeros((h, w), np.bool_)
    free[border : h - border, border : w - border] = True
    for n in range(len(taken)):
        j, i = round(taken[n, 0]), round(taken[n, 1])
        free[max(0, i - distance) : max(0, i + distance + 1),
             max(0, j - distance) : max(0, j + distance + 1)] = False  # fmt: skip
    return free


@_compiled
def _peaks(score: F32, free: Mask, border: int, least: float) -> tuple[Index, F32]:
    """Places (N,) in the flat image, and scores, of what is higher than its neighbours."""
    h, w = score.shape
    count = 0
    where, value = np.empty(h * w, np.int64), np.empty(h * w, np.float32)
    for i in range(max(1, border), h - max(1, border)):
        for j in range(max(1, border), w - max(1, border)):
            s = score[i, j]
            if s > least and free[i, j]:
                peak = s >= score[i, j - 1] and s >= score[i - 1, j]
                if peak and s > score[i, j + 1] and s > score[i + 1, j]:
                    where[count], value[count] = i * w + j, s
                    count += 1
    return where[:count], value[:count]


@_compiled
def _chosen(peaks: Index, free: Mask, distance: int, most: int) -> F64:
    """Take peaks in turn, each if none before it is near, as points (M, 2) px; `free` changes."""
    chosen = np.empty((most, 2))
    found, w = 0, free.shape[1]
    for peak in peaks:
        i, j = peak // w, peak % w
        if found == most:
            break
        if free[i, j]:
            chosen[found, 0], chosen[found, 1] = j, i
            found += 1
            free[max(0, i - distance) : i + distance + 1,
                 max(0, j - distance) : j + distance + 1] = False  # fmt: skip
    return chosen[:found]


@_compiled
def products(along_x: F32, along_y: F32) -> F32:
    """Products of slopes xx, xy and yy, (3, h, w)."""
    h, w = along_x.shape
    out = np.empty((3, h, w), np.float32)
    for i in range(h):
        for j in range(w):
            x, y = along_x[i, j], along_y[i, j]
            out[0, i, j], out[1, i, j], out[2, i, j] = x * x, x * y, y * y
    return out


@_compiled
def cornerness(tensor: F32, edge_share: float) -> F32:
    """Smaller eigenvalue of a structure tensor (3, h, w) plus a share of its trace, (h, w).

    Shi and Tomasi, CVPR 1994; the share lets edges take part where there are no corners.
    """
    _, h, w = tensor.shape
    out = np.empty((h, w), np.float32)
    for i in range(h):
        for j in range(w):
            a, b, c = tensor[0, i, j], tensor[1, i, j], tensor[2, i, j]
            mean, half = np.float32(0.5) * (a + c), np.float32(0.5) * (a - c)
            smaller = mean - math.sqrt(half * half + b * b)
            out[i, j] = smaller + np.float32(edge_share) * (a + c)
    return out
