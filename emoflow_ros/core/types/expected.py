"""What is expected of a window, by who remembers the scene."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Expected(NamedTuple):
    """Flow and motion of a window, should they go on as before.

    Attributes:
        flow: gives the flow at points (N, 2) px of the sensor, (N, 2) px/s.
        angular: (3,) rad/s in the camera's optical frame.
        linear: (3,) unit direction of the camera's velocity in that frame; zeros if it only
            rotates.
    """

    flow: Callable[[Array], Array]
    angular: Array
    linear: Array
