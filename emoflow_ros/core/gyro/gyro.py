"""A gyro beside an estimator: its measurement of a window's rotation, its bias and its faults."""

import math

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.gyro.checks import (
    UNLIKELY_3,
    FreezeWatch,
    MistakeGuess,
    SteadyWatch,
    find_fault,
)
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.measurement import GyroMeasurement, Shape, fit_shape
from emoflow_ros.core.gyro.settings import GYRO
from emoflow_ros.core.types.gyro import (
    GyroFault,
    GyroReadings,
    GyroState,
    GyroStatus,
    KnownBias,
    SeenBias,
)

Array = NDArray[np.float64]

_NS_PER_S = 1e9


class Gyro:
    """One gyro beside one estimator.

    It depends on nothing but the windows and readings so far, in their order. For each window call
    `measure`, and then, where the events alone tell an angular velocity, `learn`, and where they
    show no motion, `learn_at_rest`.

    A gyro that disagrees with the events grossly in most windows of the last two seconds is
    rejected; of the last 0.4 s, where it has not agreed for two seconds before. It is compared
    further on, with less trust in its bias, and used again after two seconds in which the windows
    that turn agree.

    Args:
        config: how good the gyro is.
        by_windows: whether `learn` teaches the bias of a gyro that is used, too; else `learn_bias`
            does.

    Attributes:
        status: of the window that was measured last.
        disagreement: share of the recent windows in which gyro and events disagree.
    """

    def __init__(self, config: GyroConfig, *, by_windows: bool = True) -> None:
        self.config = config
        self._by_windows = by_windows
        self.status = GyroStatus()
        self.disagreement = 0.0
        self._bias = BiasFilter(config)
        self._freeze = FreezeWatch()
        self._steady_watch = SteadyWatch()
        self._steady: Array | None = None  # mean w (3,) of a steady gyro, with its bias
        self._t: int | None = None  # end of the last window, ns
        self._last: GyroMeasurement | None = None
        self._own: Array = np.zeros((3, 3))  # covariance of its middle without the bias
        self._guess = MistakeGuess()
        self._confirmed = False
        self._rejected = False
        self._agreed_s = 0.0
        self._disagreed_s = 0.0
        self._compared: int | None = None

    @property
    def bias(self) -> Array:
        """The bias (3,) as it is known, rad/s."""
        return self._bias.mean.copy()

    @property
    def bias_covariance(self) -> Array:
        """Its covariance (3, 3)."""
        return self._bias.covariance.copy()

    def measure(
        self, t_start: int, t_end: int, readings: GyroReadings | None
    ) -> GyroMeasurement | None:
        """Integrate the readings over an interval (ns); None if they cannot be used.

        Args:
            t_start, t_end: of the window, or of the part of it that is estimated.
            readings: those of the window; None where there is no gyro at all.
        """
        self._last = None
        self._pass_time(t_end)
        if readings is None:
            self.status = GyroStatus()
            return None
        covering = readings.covering(t_start, t_end)
        self._freeze.take(readings.covering(t_start, t_end, 0))
        noise = math.radians(self.config.noise)
        self._steady = self._steady_watch.take(readings, t_end, noise)
        fault = find_fault(covering, t_start, t_end, math.radians(self.config.range_deg_s))
        if fault is None and self._freeze.until is not None and self._freeze.until > t_start:
            fault = GyroFault.FROZEN
        if fault is not None:
            self.status = GyroStatus(GyroState.REJECTED, fault)
            return None
        shape = fit_shape(covering, t_start, t_end)
        own = self._errors(shape, (t_end - t_start) / _NS_PER_S)
        coefficients, covariances = shape.coefficients.copy(), own.copy()
        coefficients[0] -= self._bias.mean
        covariances[0] += self._bias.covariance
        self._last = GyroMeasurement(t_start, t_end, coefficients, covariances)
        self._own = own[0] + 0.25 * own[2]
        if self._rejected:
            self.status = self._disagreeing()
            return None
        self.status = GyroStatus(GyroState.USED, bias=KnownBias(self.bias, self.bias_covariance))
        return self._last

    def learn(self, w_events: Array, covariance_events: Array) -> None:
        """Compare the window that was measured last with what its events tell, without the gyro.

        Args:
            w_events: (3,) rad/s, in the middle of the interval that was measured.
            covariance_events: (3, 3) of it.
        """
        last = self._last
        if last is None or not (
            np.isfinite(w_events).all() and np.isfinite(covariance_events).all()
        ):
            return
        self._last = None
        speed = max(float(np.linalg.norm(last.middle)), float(np.linalg.norm(w_events)))
        known = covariance_events + self._own + GYRO.floor**2 * np.eye(3)
        self._guess.add(last.middle + self._bias.mean, w_events)
        teaches = self._by_windows or self._rejected
        self._judge(last.middle - w_events, known, speed, last.t_end)
        if teaches:
            self._bias.update(
                last.middle + self._bias.mean - w_events,
                known + (GYRO.relative_floor * speed) ** 2 * np.eye(3),
                max(GYRO.correlated_s, (last.t_end - last.t_start) / _NS_PER_S),
            )

    def learn_bias(self, seen: SeenBias) -> None:
        """Learn the bias from what the events show of it over some time.

        They are told from outliers already: one that is far from the expected bias counts, too.
        """
        difference = self._bias.mean + seen.excess
        self._bias.update(difference, seen.covariance, seen.seconds, gated=False)

    def learn_at_rest(self) -> None:
        """Learn the bias from the window that was measured last, whose events show no motion.

        A camera whose gyro is steady as well is taken to be at rest (a zero-velocity update).
        """
        if self._last is not None and self._steady is not None:
            self._last = None
            known = GYRO.at_rest**2 * np.eye(3) + self._own
            self._bias.update(self._steady, known, GYRO.rest_s, at_rest=True)

    def _pass_time(self, t_end: int) -> None:
        """Go on to a window; one that ends earlier is of another recording, or a loop of this."""
        if self._t is not None and t_end < self._t:
            self._freeze = FreezeWatch()
            self._compared = None
        elif self._t is not None:
            self._bias.advance((t_end - self._t) / _NS_PER_S)
        self._t = t_end

    def _errors(self, shape: Shape, duration: float) -> Array:
        """Covariances (3, 3, 3) of the coefficients without that of the bias.

        What happens in a gap counts most for coefficient k at an end of the interval, where the
        polynomial is 1: 2 k + 1 times what it counts for the mean. The coefficients are taken to be
        independent, so the middle's variance is rather too large where there are gaps.
        """
        config = self.config
        noise = math.radians(config.noise) ** 2 / duration
        # Changes of the first two coefficients per second that the interval is shifted by.
        shift = np.array([[2.0], [6.0]]) * shape.coefficients[1:] / duration
        turned = math.radians(config.rotation_error_deg) ** 2
        covariances = np.empty((3, 3, 3))
        for k, row in enumerate(shape.coefficients):
            covariances[k] = (
                (2 * k + 1) * (noise + (2 * k + 1) * shape.gap_variance) * np.eye(3)
                + np.diag((config.scale_error * row) ** 2)
                + turned * (row @ row * np.eye(3) - np.outer(row, row))
            )
        covariances[:2] += GYRO.clock_s**2 * np.einsum("ki,kj->kij", shift, shift)
        return covariances

    def _judge(self, apart: Array, known: Array, speed: float, t: int) -> None:
        """Note whether a window agrees, and reject or accept the gyro by the recent windows."""
        spread = known + self._bias.covariance
        gross = spread + (GYRO.gross * speed) ** 2 * np.eye(3)
        agrees = float(apart @ np.linalg.solve(gross, apart)) < UNLIKELY_3
        telling = speed > GYRO.telling * math.sqrt(float(np.trace(spread)))
        if agrees and not telling:
            return
        seconds = 0.0 if self._compared is None else min((t - self._compared) / _NS_PER_S, 0.2)
        self._compared = t
        memory = GYRO.memory_s if self._confirmed and not self._rejected else GYRO.first_memory_s
        share = 1 - math.exp(-seconds / memory)
        self.disagreement += share * ((not agrees) - self.disagreement)
        if self._rejected:
            self._try_again(agrees, seconds)
        elif self.disagreement > GYRO.rejected_share:
            self._rejected, self._agreed_s, self._disagreed_s = True, 0.0, 0.0
            self._bias.doubt()
            self.status = self._disagreeing()
        elif agrees:
            self._agreed_s += seconds
            self._confirmed |= self._agreed_s >= GYRO.memory_s

    def _try_again(self, agrees: bool, seconds: float) -> None:
        """Take a rejected gyro back when it agrees, doubt its bias while it does not."""
        self._agreed_s = self._agreed_s + seconds if agrees else 0.0
        self._disagreed_s = 0.0 if agrees else self._disagreed_s + seconds
        if self._disagreed_s > GYRO.retry_s:
            self._bias.doubt()
            self._disagreed_s = 0.0
        if self._agreed_s >= GYRO.memory_s and self.disagreement < GYRO.accepted_share:
            self._rejected = False

    def _disagreeing(self) -> GyroStatus:
        reason = f"{GyroFault.DISAGREES}: {round(100 * self.disagreement)} % of windows"
        guess = self._guess.in_words()
        return GyroStatus(GyroState.REJECTED, f"{reason}, {guess}" if guess else reason)


class BiasFilter:
    """A Kalman filter of the bias (3,), a random walk.

    The events' estimates come from windows that overlap, and each starts from the one before it, so
    that their errors repeat. An update after dt seconds therefore counts dt / tau of one: together
    they tell as much as estimates that are tau apart.

    Attributes:
        mean: (3,) rad/s.
        covariance: (3, 3).
    """

    def __init__(self, config: GyroConfig) -> None:
        self._start = np.radians(config.bias_deg_s) ** 2 * np.eye(3)
        self._walk = float(np.radians(config.bias_walk) ** 2)
        self.mean = np.zeros(3)
        self.covariance = self._start.copy()
        self._since_update = {False: np.inf, True: np.inf}  # by whether it was at rest, s

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.covariance = self.covariance + self._walk * seconds * np.eye(3)
        for at_rest in self._since_update:
            self._since_update[at_rest] += seconds

    def doubt(self) -> None:
        """Trust what is known half as much, down to eight times the bias that is expected."""
        most = GYRO.most_doubt**2 * np.trace(self._start)
        if np.trace(self.covariance) < most:
            self.covariance = 4 * self.covariance + self._start

    def update(
        self, difference: Array, covariance: Array, repeat_s: float, *, at_rest: bool = False,
        gated: bool = True,
    ) -> None:  # fmt: skip
        """Take the gyro's reading less the events' estimate.

        Args:
            difference: (3,) rad/s.
            covariance: (3, 3) of all in it but the bias.
            repeat_s: tau, s.
            at_rest: what it is learnt from; the updates of each kind repeat their errors.
            gated: whether outliers are left out.
        """
        apart = difference - self.mean
        if gated and apart @ np.linalg.solve(self.covariance + covariance, apart) > UNLIKELY_3:
            return
        repeated = max(1.0, repeat_s / max(self._since_update[at_rest], 1e-3))
        noise = repeated * covariance
        gain = np.linalg.solve(self.covariance + noise, self.covariance).T
        kept = np.eye(3) - gain
        self.mean = self.mean + gain @ apart
        self.covariance = kept @ self.covariance @ kept.T + gain @ noise @ gain.T
        self._since_update[at_rest] = 0.0
