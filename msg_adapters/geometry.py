"""Which events lie outside the sensor."""

import numpy as np
from numba import njit, types

_COORDINATES = types.Array(types.uint16, 1, "C", readonly=True)


@njit(types.boolean(_COORDINATES, _COORDINATES, types.int64, types.int64), cache=True, nogil=True)
def any_outside(x, y, width, height):  # type: ignore[no-untyped-def]
    """Whether any of the coordinates x, y (N,) uint16 lies outside width x height pixels."""
    x_max = y_max = np.uint16(0)
    for i in range(len(x)):
        x_max = max(x_max, x[i])
        y_max = max(y_max, y[i])
    return x_max >= width or y_max >= height
