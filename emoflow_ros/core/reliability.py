"""Estimates that the events do not carry are withheld.

Sparse texture, noise and objects that move can leave a window with a sharp image of warped events
and a wrong flow. What such windows have in common was learnt from the random recordings.
"""

import math

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.estimate import Estimate, Estimator, Quality, Status
from emoflow_ros.core.windows import Window

Array = NDArray[np.float64]

# Logistic regression of "the end-point error exceeds half of the displacement, or w is off by 3 of
# its standard deviations and 5 deg/s" over 3000 windows of the random recordings with seeds 0 to
# 59; by five-fold cross-validation over recordings its area under the ROC curve is 0.69
# (docs/method.md).
_CONSTANT = -5.346
_OF_EVIDENCE = -1.300  # natural logarithm of the evidence's sum, px^-2
_OF_INLIERS = -3.824  # share of the epipolar residuals within 3 robust scales
_OF_EXTENT = -1.118  # logarithm of the share of nodes that the evidence is spread over
_OF_EVENTS = 1.445  # logarithm of the number of events
_OF_GAIN = -0.699  # logarithm of the contrast gain less 0.98
_OF_CHANGE = 0.985  # logarithm of the change that the fit leaves out, plus 0.2 px
_OF_DURATION = 0.212  # logarithm of the window's length in s
_OF_SPEED = 0.505  # logarithm of the displacement plus 0.5 px
_OF_JUMP = 0.271  # logarithm of the jump of w plus 1 deg/s, in rad/s
_LARGEST_CHANGE_PX = 20.0


def probability_of_failure(
    evidence: Array, flow: Array, duration: float, jump: float, quality: Quality
) -> float:
    """Tell how likely a window's estimate is wrong, from 0 to 1.

    Args:
        evidence: (nodes,) the events' information on the flow (trace), px^-2.
        flow: (nodes, 2) px per window.
        duration: of the window, s.
        jump: of w since the last windows, rad/s.
        quality: its events, gain, inliers and change.
    """
    total = float(evidence.sum())
    extent = total**2 / (len(evidence) * float(evidence @ evidence) + 1e-12)
    displacement = math.sqrt(float(evidence @ (flow**2).sum(axis=1)) / max(total, 1e-9))
    score = (
        _CONSTANT
        + _OF_EVIDENCE * math.log(1 + max(0.0, total))
        + _OF_INLIERS * quality.inlier_fraction
        + _OF_EXTENT * math.log(extent + 1e-12)
        + _OF_EVENTS * math.log(max(1, quality.events))
        + _OF_GAIN * math.log(max(0.0, quality.contrast_gain - 1) + 0.02)
        + _OF_CHANGE * math.log(min(quality.change_px, _LARGEST_CHANGE_PX) + 0.2)
        + _OF_DURATION * math.log(duration)
        + _OF_SPEED * math.log(displacement + 0.5)
        + _OF_JUMP * math.log(jump + math.radians(1.0))
    )
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
