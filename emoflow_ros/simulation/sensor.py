"""The event sensor: contrast thresholds, refractory period and background noise."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from emoflow_ros.core.events import Events
from emoflow_ros.errors import InputError

_TICK = 1_000  # ns: event cameras stamp in microseconds


@dataclass(frozen=True)
class SensorModel:
    """Parameters of an event pixel.

    Args:
        threshold_on, threshold_off: change of log intensity per event.
        mismatch: standard deviation of each threshold from pixel to pixel, as a fraction.
        refractory_us: after an event, a pixel sends nothing for this long.
        noise_hz: background events per second and pixel; None takes the scene's rate.

    Raises:
        InputError: a value out of its range.
    """

    threshold_on: float = 0.2
    threshold_off: float = 0.2
    mismatch: float = 0.1
    refractory_us: int = 300
    noise_hz: float | None = None

    def __post_init__(self) -> None:
        if not (self.threshold_on >= 0.01 and self.threshold_off >= 0.01):
            raise InputError(
                "sensor.threshold",
                f"on {self.threshold_on}, off {self.threshold_off}",
                "give at least 0.01",
            )
        if not 0 <= self.mismatch <= 0.5:
            raise InputError("sensor.mismatch", f"{self.mismatch}", "give a value in [0, 0.5]")
        if self.refractory_us < 0:
            raise InputError(
                "sensor.refractory_us", f"{self.refractory_us}", "give 0 or more microseconds"
            )
        if self.noise_hz is not None and not 0 <= self.noise_hz <= 1000:
            raise InputError("sensor.noise_hz", f"{self.noise_hz}", "give a value in [0, 1000]")


class EventPixels:
    """The state of all pixels, driven by one log-intensity image after another.

    Between two images log intensity is linear in time. An event is sent where it has moved a
    threshold away from the level of the pixel's last event; a crossing within the refractory
    period moves that level too, but is not sent (Rebecq et al., ESIM, CoRL 2018).

    Args:
        model: the sensor.
        image: (H, W) log intensity at time t.
        t: ns.
        rng: draws the mismatch, and where between its thresholds each pixel starts.
    """

    def __init__(
        self,
        model: SensorModel,
        image: NDArray[np.float32],
        t: int,
        rng: np.random.Generator,
    ) -> None:
        spread = 1 + model.mismatch * rng.standard_normal((2, *image.shape))
        nominal = np.array([model.threshold_on, model.threshold_off])[:, None, None]
        self.thresholds = nominal * np.maximum(spread, 0.1)
        start = rng.uniform(-self.thresholds[0], self.thresholds[1])
        self.level = image + start
        self._refractory = model.refractory_us * 1_000
        self._last = np.full(image.shape, t - self._refractory - _TICK, np.int64)
        self._image = image
        self._t = t

    def advance(self, image: NDArray[np.float32], t: int) -> Events:
        """Take the image of time t (ns) and return the events since the image before it.

        The events are in pixel order, not in time order.
        """
        x, y, times, p = _crossings(
            self._image,
            image,
            self._t,
            t,
            self.thresholds,
            self.level,
            self._last,
            self._refractory,
        )
        self._image, self._t = image, t
        return Events(x, y, times, p)


def background_noise(
    rate_hz: float, shape: tuple[int, int], t_start: int, t_end: int, rng: np.random.Generator
) -> Events:
    """Events of a homogeneous Poisson process of `rate_hz` per pixel, of random polarity."""
    height, width = shape
    count = int(rng.poisson(rate_hz * height * width * (t_end - t_start) / 1e9))
    return Events(
        rng.integers(0, width, count, dtype=np.uint16),
        rng.integers(0, height, count, dtype=np.uint16),
        t_start + _TICK * rng.integers(0, (t_end - t_start) // _TICK, count),
        rng.random(count) < 0.5,
    )


@njit(cache=True)
def _crossings(  # type: ignore[no-untyped-def]
    before, after, t_before, t_after, thresholds, level, last, refractory
):
    height, width = before.shape
    capacity = 4096
    xs = np.empty(capacity, np.uint16)
    ys = np.empty(capacity, np.uint16)
    ts = np.empty(capacity, np.int64)
    ps = np.empty(capacity, np.bool_)
    count = 0
    for row in range(height):
        for column in range(width):
            start, end = before[row, column], after[row, column]
            reference = level[row, column]
            brighter = end > reference
            step = thresholds[0 if brighter else 1, row, column]
            if abs(end - reference) < step or start == end:
                continue
            signed = step if brighter else -step
            while abs(end - reference) >= step and (end > reference) == brighter:
                reference += signed
                elapsed = (reference - start) / (end - start) * (t_after - t_before)
                t = (t_before + int(elapsed)) // _TICK * _TICK
                if t - last[row, column] < refractory:
                    continue
                last[row, column] = t
                if count == capacity:
                    capacity *= 2
                    xs, ys = _grow(xs, capacity), _grow(ys, capacity)
                    ts, ps = _grow(ts, capacity), _grow(ps, capacity)
                xs[count], ys[count], ts[count], ps[count] = column, row, t, brighter
                count += 1
            level[row, column] = reference
    return xs[:count], ys[:count], ts[:count], ps[:count]


@njit(cache=True)
def _grow(column, capacity):  # type: ignore[no-untyped-def]
    grown = np.empty(capacity, column.dtype)
    grown[: len(column)] = column
    return grown
