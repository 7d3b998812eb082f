"""The event sensor: pixels with contrast thresholds, and what disturbs real pixels.

The disturbances: slow photoreceptors, noise, hot pixels, lost events, and a lamp that flickers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events
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


class Photoreceptor:
    """A low-pass filter on log intensity whose bandwidth grows with the light.

    Args:
        cutoff_hz: at log intensity 0; e times the light has e times the bandwidth.
        image: (H, W) log intensity at the start.
    """

    def __init__(self, cutoff_hz: float, image: NDArray[np.float32]) -> None:
        self._cutoff = cutoff_hz
        self._state = image.copy()

    def advance(self, image: NDArray[np.float32], seconds: float) -> NDArray[np.float32]:
        """Return what the pixels hold `seconds` later, (H, W), with `image` shown to them."""
        _follow(self._state, image, 2 * np.pi * self._cutoff * seconds)
        return self._state.copy()


class Lamp:
    """A lamp fed with alternating current that lights a round patch of the scene.

    Args:
        bearings: (H, W, 2) of the pixels.
        direction: (3,) unit vector to the middle of the patch in the world, which is far away.
        radius: of the patch, rad.
        depth: of the modulation of the light there.
        hz: of the flicker.
    """

    def __init__(
        self,
        bearings: NDArray[np.float64],
        direction: NDArray[np.float64],
        radius: float,
        depth: float,
        hz: float,
    ) -> None:
        self._bearings = bearings
        self._direction = direction
        self._radius = radius
        self._depth, self._hz = depth, hz

    def light(
        self, image: NDArray[np.float32], rotation: NDArray[np.float64], seconds: float
    ) -> None:
        """Add the lamp's light to log intensity (H, W), seen from world-from-camera (3, 3)."""
        level = np.log1p(self._depth * np.sin(2 * np.pi * self._hz * seconds))
        inner, outer = np.cos(0.8 * self._radius), np.cos(self._radius)
        _light(image, self._bearings, rotation.T @ self._direction, level, inner, outer)


def hot_pixels(
    count: int, shape: tuple[int, int], t_start: int, t_end: int, rng: np.random.Generator
) -> Events:
    """Events of `count` hot pixels, which fire 20 to 1000 times per second at constant light."""
    height, width = shape
    rates = np.exp(rng.uniform(np.log(20), np.log(1000), count))
    counts = rng.poisson(rates * (t_end - t_start) / NS_PER_S)
    total = int(counts.sum())
    return Events(
        np.repeat(rng.integers(0, width, count, dtype=np.uint16), counts),
        np.repeat(rng.integers(0, height, count, dtype=np.uint16), counts),
        t_start + _TICK * rng.integers(0, (t_end - t_start) // _TICK, total),
        rng.random(total) < 0.8,
    )


def lose_bursts(events: Events, share: float, rng: np.random.Generator) -> Events:
    """Drop all events of random gaps of 1 to 10 ms which take `share` of the time.

    Args:
        events: sorted by time.
        share: of the time, in [0, 1).
        rng: draws the gaps.
    """
    if share == 0 or len(events) == 0:
        return events
    begin, end = int(events.t[0]), int(events.t[-1])
    mean_gap = 5.5 * NS_PER_MS
    count = max(1, round(2 * (end - begin) / mean_gap))
    lost = rng.integers(NS_PER_MS, 10 * NS_PER_MS, count)
    kept = rng.exponential(mean_gap * (1 - share) / share, count).astype(np.int64)
    edges = begin + np.cumsum(np.stack([kept, lost], axis=1).ravel())
    return events[np.searchsorted(edges, events.t, side="right") % 2 == 0]


@njit()
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


@njit()
def _grow(column, capacity):  # type: ignore[no-untyped-def]
    grown = np.empty(capacity, column.dtype)
    grown[: len(column)] = column
    return grown


@njit(nogil=True)
def _follow(state, image, product):  # type: ignore[no-untyped-def]
    height, width = state.shape
    for row in range(height):
        for column in range(width):
            value = image[row, column]
            step = product * np.exp(value)
            # Implicit Euler: stable for steps of any length.
            state[row, column] += np.float32(step / (1 + step)) * (value - state[row, column])


@njit(nogil=True)
def _light(image, bearings, direction, level, inner, outer):  # type: ignore[no-untyped-def]
    height, width = image.shape
    for row in range(height):
        for column in range(width):
            x, y = bearings[row, column, 0], bearings[row, column, 1]
            length = np.sqrt(x * x + y * y + 1)
            cosine = (direction[0] * x + direction[1] * y + direction[2]) / length
            if cosine > outer:
                image[row, column] += level * min((cosine - outer) / (inner - outer), 1.0)
