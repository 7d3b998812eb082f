"""How wrong latest twists were, as the windows of their times have told since."""

from collections import deque
from dataclasses import replace

import numpy as np

from emoflow_ros.core.products.settings import PRESENT
from emoflow_ros.core.types.estimate import Estimate, Status
from emoflow_ros.core.types.twist import PresentTwist


class Hindsight:
    """Scales the covariance of w of latest twists by what windows show of them later.

    A window that holds a latest twist's time tells its w better. The square of the difference over
    the covariance shows how right that is (R. K. Mehra, On the identification of variances and
    adaptive Kalman filtering, IEEE Trans. Automatic Control 15(2), 1970): its mean over the usual
    one is the scale, at first 1.
    """

    def __init__(self) -> None:
        self._told: deque[PresentTwist] = deque()  # not scaled, by time
        self._surprise = PRESENT.usual_surprise

    def scaled(self, found: PresentTwist) -> PresentTwist:
        """Return a latest twist with its covariance scaled, and keep it until its window comes."""
        told, t = self._told, found.twist.t
        if told and t <= told[-1].twist.t:
            told.clear()
        while told and told[0].twist.t < t - PRESENT.longest_ns:
            told.popleft()
        told.append(found)
        scale = max(PRESENT.least_scale, self._surprise / PRESENT.usual_surprise)
        of_twist = np.repeat([1.0, np.sqrt(scale)], 3)
        return replace(found, covariance=found.covariance * np.outer(of_twist, of_twist))

    def learn(self, estimate: Estimate) -> None:
        """Compare what a window measured with the twist nearest to its middle."""
        if estimate.motion is None or estimate.status is not Status.OK:
            return
        its = [x for x in self._told if estimate.t_start <= x.twist.t <= estimate.t_end]
        if not its:
            return
        found = min(its, key=lambda x: abs(x.twist.t - estimate.t))
        off = found.twist.angular - estimate.motion.angular(found.twist.t)
        square = float(off @ np.linalg.solve(found.covariance[3:, 3:], off)) / 3
        if np.isfinite(square):
            square = min(square, PRESENT.most_surprise)
            self._surprise += PRESENT.of_surprise * (square - self._surprise)
