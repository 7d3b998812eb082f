"""The covariance of the linear velocity as a filter reads it: what nothing is known of is wide."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.twist import covariance_at_speed

WIDE, REP_145 = "wide", "rep145"
UNKNOWN = 1e6  # (m/s)^2: a standard deviation beyond all cameras, and no trouble for 64 bits


def published_covariance(
    covariance: NDArray[np.float64], direction: NDArray[np.float64], speed: float | None, form: str
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of (linear, angular) that is published with a twist.

    Args:
        covariance: that of the unit direction and the angular velocity, (6, 6); [0, 0] is -1 where
            translation is not observable.
        direction: of translation, (3,), of unit length where it is observable, zeros at rest.
        speed: what the direction is multiplied by, taken as exact, m/s; None: its length is no
            speed.
        form: WIDE gives the variance UNKNOWN to what nothing is known of: all of linear where
            translation is not observable, and without a speed the length along the direction.
            REP_145 keeps the mark of -1, and 0 elsewhere.
    """
    at_rest = covariance[0, 0] >= 0 and not direction.any()  # in m/s already
    scaled = covariance_at_speed(covariance, 1.0 if speed is None or at_rest else speed)
    if form == REP_145:
        return scaled
    wide = scaled.copy()
    if covariance[0, 0] < 0:
        wide[:3], wide[:, :3] = 0.0, 0.0
        wide[:3, :3] = UNKNOWN * np.eye(3)
    elif speed is None:
        wide[:3, :3] += UNKNOWN * np.outer(direction, direction)
    return wide
