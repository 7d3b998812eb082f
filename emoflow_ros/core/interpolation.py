"""Linear interpolation of a grid of vectors at points, compiled."""

import numba
import numpy as np
from numpy.typing import NDArray


@numba.njit(cache=True, nogil=True)
def bilinear(
    grid: NDArray[np.float32], points: NDArray[np.float64], per_px: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Interpolate a grid (columns, rows, 2) at points (N, 2) px, constant beyond its border.

    Args:
        grid: the values at the nodes.
        points: x and y; a point that is not finite gets NaN.
        per_px: cells per pixel in x and y.

    Returns:
        (N, 2).
    """
    columns, rows = grid.shape[:2]
    out = np.empty((len(points), 2), np.float32)
    for i in range(len(points)):
        x, y = points[i, 0] * per_px[0], points[i, 1] * per_px[1]
        if not (np.isfinite(x) and np.isfinite(y)):
            out[i] = np.nan
            continue
        x, y = min(max(x, 0.0), columns - 1.0), min(max(y, 0.0), rows - 1.0)
        c, r = min(int(x), columns - 2), min(int(y), rows - 2)
        a, b = x - c, y - r
        for d in range(2):
            left = (1 - b) * grid[c, r, d] + b * grid[c, r + 1, d]
            right = (1 - b) * grid[c + 1, r, d] + b * grid[c + 1, r + 1, d]
            out[i, d] = (1 - a) * left + a * right
    return out
