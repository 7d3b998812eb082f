"""How likely a window's estimate is wrong, and what becomes of one that is.

Two other explanations of a window are compared with its estimate: a fresh fit (core.second_look)
and the scene of an earlier window (core.earlier_scene). Their distances from the estimate, and the
length of the flow, give a probability that the estimate is wrong: the shorter the flow, the more a
distance counts. The windows of one scene are often wrong together. So the probability is higher if
few of the last windows were confirmed: a window that agrees then often does so by chance.
"""

import math
from collections import deque
from dataclasses import replace

from emoflow_ros.core.estimate import Estimate, Estimator, Status
from emoflow_ros.core.events import Window
from emoflow_ros.core.gyro_checks import GyroState
from emoflow_ros.core.uncertainty import Disagreement

# A window is confirmed by the product of the two distances over the length of its flow, px; without
# an earlier scene by the one distance. 0.1 px is added to each length.
_CONFIRMED_PX, _CONFIRMED_ALONE_PX = 1 / 3, 0.85
_RECORD = 20  # estimates that are remembered
_UNKNOWN = 5  # as many more, half of them confirmed, are what is assumed before any is known

# Logistic regression of "the end-point error exceeds half of the displacement, or w or v is off by
# 3 of its standard deviations and 5 deg/s or 20 degrees" over 5607 windows of the random recordings
# with seeds 0 to 59 and those of the shared data (docs/method.md). Constant, then factors of the
# natural logarithms of the lengths, then of the share of confirmed windows.
_BOTH = -0.1, 0.9, 0.55, -0.8, -2.0
# The first number is lower than the regression's, which would withhold nearly every start.
_ALONE = -1.45, 0.8, -2.0


class Doubt:
    """Judges one window after another."""

    def __init__(self) -> None:
        self._record: deque[bool] = deque(maxlen=_RECORD)

    def forget(self) -> None:
        """Forget the windows so far."""
        self._record.clear()

    def weigh(self, apart: Disagreement) -> float:
        """Tell how likely the estimate of a window is wrong, from 0 to 1.

        Args:
            apart: how far other explanations lie from it.
        """
        share = (sum(self._record) + 0.5 * _UNKNOWN) / (len(self._record) + _UNKNOWN)
        look, earlier, moved = (math.log(length) for length in _lengths(apart))
        if math.isnan(earlier):
            score = _ALONE[0] + _ALONE[1] * look + _ALONE[2] * share
        else:
            score = _BOTH[0] + _BOTH[1] * look + _BOTH[2] * earlier + _BOTH[3] * moved
            score += _BOTH[4] * share
        return 1 / (1 + math.exp(-score))

    def remember(self, apart: Disagreement) -> None:
        """Remember whether a window with an estimate was confirmed, for those to come."""
        look, earlier, moved = _lengths(apart)
        alone = math.isnan(earlier)
        confirmed = look < _CONFIRMED_ALONE_PX if alone else look * earlier < _CONFIRMED_PX * moved
        self._record.append(confirmed)


def _lengths(apart: Disagreement) -> tuple[float, float, float]:
    """Distances to the second look and the earlier scene, length of the flow, each + 0.1 px."""
    return apart.second_look_px + 0.1, apart.earlier_px + 0.1, apart.moved_px + 0.1


class ReliableOnly:
    """Withholds what is unreliable (an Estimator).

    An unreliable estimate gets the status `uncertain`, and nothing else. With a gyro only its flow
    is withheld, and v if the flow is more doubtful still (core.reading): w is known.

    Sparse texture, noise and objects that move can leave a window with a sharp image of warped
    events and a wrong flow. The estimator starts the next window from it all the same, which often
    corrects it.

    Args:
        estimator: whose estimates are judged.
        max_doubt: probability of failure above which an estimate, or its flow, is withheld.
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
        if found.gyro.state is GyroState.USED:
            return replace(found, flow=None)
        return Estimate(
            found.t_start, found.t_end, found.t, Status.UNCERTAIN, found.quality, gyro=found.gyro
        )
