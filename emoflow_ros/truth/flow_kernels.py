"""Inner loop of true flow over several maps, in numba."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit


@njit(nogil=True)
def carry(
    flow: NDArray[np.float32],
    mover: NDArray[np.bool_],
    share: float,
    moved: NDArray[np.float64],
    valid: NDArray[np.bool_],
    moving: NDArray[np.bool_],
) -> None:
    """Move every pixel on, by a share of the flow at the pixel nearest to where it is.

    Args:
        flow: (H, W, 2) px.
        mover: (H, W), which of its pixels see a moving object.
        share: of the flow.
        moved: (H, W, 2) px, how far each pixel has come; added to.
        valid: (H, W), cleared where there is no flow; the pixel stays there.
        moving: (H, W), set where the nearest pixel sees a moving object.
    """
    height, width = flow.shape[:2]
    for i in range(height):
        for j in range(width):
            column, row = int(np.rint(j + moved[i, j, 0])), int(np.rint(i + moved[i, j, 1]))
            if not (0 <= column < width and 0 <= row < height):
                valid[i, j] = False
                continue
            moving[i, j] |= mover[row, column]
            u, v = flow[row, column]
            if np.isfinite(u) and np.isfinite(v) and (u != 0 or v != 0):
                moved[i, j, 0] += share * u
                moved[i, j, 1] += share * v
            else:
                valid[i, j] = False
