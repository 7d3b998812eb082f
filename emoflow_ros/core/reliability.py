"""Estimates that the events do not carry are withheld.

Sparse texture, noise and objects that move can leave a window with a sharp image of warped events
and a wrong flow. A fresh fit of the same events then comes out elsewhere (core.second_look).
"""

import math

from emoflow_ros.core.estimate import Estimate, Estimator, Status
from emoflow_ros.core.windows import Window

# Logistic regression of "the end-point error exceeds half of the displacement, or w is off by 3 of
# its standard deviations and 5 deg/s" over 3200 windows of the random recordings with seeds 0 to
# 59 and those of the shared data; by five-fold cross-validation over recordings its area under the
# ROC curve is 0.81 (docs/method.md).
_CONSTANT = -2.419
_OF_SECOND_LOOK = 1.303  # natural logarithm of the distance plus 0.1 px


def probability_of_failure(second_look_px: float) -> float:
    """Tell how likely a window's estimate is wrong, from 0 to 1.

    Args:
        second_look_px: how far a fresh fit lies from it (core.second_look).
    """
    score = _CONSTANT + _OF_SECOND_LOOK * math.log(second_look_px + 0.1)
    return 1 / (1 + math.exp(-score))


class ReliableOnly:
    """Gives the status `uncertain`, and nothing else, to unreliable estimates (an Estimator).

    The estimator goes on from them all the same: the next window often makes up for them.

    Args:
        estimator: whose estimates are judged.
        max_doubt: probability of failure above which an estimate is withheld.
    """

    def __init__(self, estimator: Estimator, max_doubt: float) -> None:
        self._estimator = estimator
        self._max_doubt = max_doubt

    def reset(self) -> None:
        """Forget previous windows."""
        self._estimator.reset()

    def estimate(self, window: Window) -> Estimate:
        """Estimate a window, if that can be done reliably."""
        found = self._estimator.estimate(window)
        if found.status is not Status.OK or not found.quality.doubt > self._max_doubt:
            return found
        return Estimate(
            found.t_start, found.t_end, found.t, Status.UNCERTAIN, found.quality, gyro=found.gyro
        )
