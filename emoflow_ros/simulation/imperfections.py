"""What real event pixels do beyond thresholds: slow in the dark, leaks, hot pixels, lost events."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S

_TICK = 1_000  # ns: event cameras stamp in microseconds


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
    """Events of `count` pixels that fire 20 to 1000 times a second of themselves."""
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


@njit(cache=True, nogil=True)
def _follow(state, image, product):  # type: ignore[no-untyped-def]
    height, width = state.shape
    for row in range(height):
        for column in range(width):
            value = image[row, column]
            step = product * np.exp(value)
            # Implicit Euler: stable for steps of any length.
            state[row, column] += np.float32(step / (1 + step)) * (value - state[row, column])


@njit(cache=True, nogil=True)
def _light(image, bearings, direction, level, inner, outer):  # type: ignore[no-untyped-def]
    height, width = image.shape
    for row in range(height):
        for column in range(width):
            x, y = bearings[row, column, 0], bearings[row, column, 1]
            length = np.sqrt(x * x + y * y + 1)
            cosine = (direction[0] * x + direction[1] * y + direction[2]) / length
            if cosine > outer:
                image[row, column] += level * min((cosine - outer) / (inner - outer), 1.0)
