"""What an adjustment tells of a gyro's bias."""

import numpy as np

from emoflow_ros.core.back_end.adjustment import Adjusted
from emoflow_ros.core.back_end.prior_kernels import Prior, gyro_bias
from emoflow_ros.core.types.gyro import SeenBias

_LEAST = 1e-3  # information that is as good as none, over what was known before


def seen_bias(found: Adjusted, known: Prior) -> SeenBias | None:
    """Read it off an adjustment.

    Args:
        found: the adjustment.
        known: its prior, with a gyro's angular velocities.

    Returns:
        None without a gyro, or where nothing more is known of the bias than before.
    """
    if not known.measured_biased.any():
        return None
    bias = gyro_bias(found.x, known)
    try:
        by_motion = np.linalg.solve(bias.information, bias.cross[found.free].T)  # (3, U)
        covariance = np.linalg.inv(bias.information) + by_motion @ found.covariance @ by_motion.T
        information = np.linalg.inv(covariance)
        of_places = information - known.bias_information
        if np.linalg.eigvalsh(of_places)[0] <= _LEAST * np.trace(known.bias_information):
            return None
        excess = information @ np.linalg.solve(bias.information, bias.right)
        own = np.linalg.inv(of_places)
    except np.linalg.LinAlgError:
        return None
    return SeenBias(np.asarray(own @ excess), own, float(known.seconds.sum()))
