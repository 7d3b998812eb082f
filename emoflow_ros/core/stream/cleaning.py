"""Events that tell no motion, left out of whole windows: of hot pixels and of flickering lamps."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.stream.thinning import spread_places
from emoflow_ros.core.types.estimate import Estimate, Estimator
from emoflow_ros.core.types.events import Events, Window

_FEWEST_HOT = 5  # number of events that any pixel may have
_SHARE_OF_NEIGHBOURS = 0.5  # share of its eight neighbours' events that a pixel may have besides

MAINS_HZ = (100.0, 120.0)

_LAMP_BLOCK = 16  # sensor pixels along a side of a block
_LAMP_PARTS = 3  # parts of the time, each of which must show the flicker by itself
_SHORTEST_LAMP_S = 0.02  # two periods
_COHERENT = 0.35  # share of the polarity that goes with the mains from which a block flickers
_CERTAIN = 5.0  # n times the square of that: exp(-5) is its chance without flicker, per part
_LAMP_SAMPLE = 20_000  # events that suffice
_TURN = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
_WAVE = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)


def clean(window: Window, camera: Camera) -> Window:
    """Leave out a window's events off the sensor, of hot pixels and of flickering lamps."""
    events = window.events
    inside = events.inside(*camera.size)
    if not inside.all():
        events = events[inside]
    events = without_hot_pixels(events, *camera.size)
    return replace(window, events=without_flicker(events, *camera.size))


class CleanWindows:
    """Leaves out what tells no motion before windows are estimated (an Estimator).

    This comes before the motion decides how many events of a window are estimated: a lamp may
    send a hundred times as many as the edges, and shows its frequency in a long window only.

    Args:
        estimator: of the clean windows.
        camera: whose pixels the events lie on.
    """

    def __init__(self, estimator: Estimator, camera: Camera) -> None:
        self._estimator = estimator
        self._camera = camera

    def reset(self) -> None:
        """Forget previous windows: the next one starts cold."""
        self._estimator.reset()

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to what stays of a window."""
        return self._estimator.estimate(clean(window, self._camera))


def without_hot_pixels(events: Events, width: int, height: int) -> Events:
    """Leave out the pixels that fire far more often than their eight neighbours together explain.

    An edge crosses neighbouring pixels alike. A hot pixel fires alone; all its events lie at one
    place, so that it holds the flow around it at zero.

    Args:
        events: on the sensor.
        width, height: of the sensor in pixels.
    """
    hot = _hot(events.x, events.y, width, height)
    return events[_cool(events.x, events.y, hot)] if hot.any() else events


@njit(nogil=True)
def _hot(
    x: NDArray[np.uint16], y: NDArray[np.uint16], width: int, height: int
) -> NDArray[np.bool_]:
    """Mask (height, width) of the hot pixels; all events lie on the sensor."""
    count = np.zeros((height + 2, width + 2), np.int32)  # a frame spares the border's cases
    for k in range(len(x)):
        count[y[k] + 1, x[k] + 1] += 1
    hot = np.zeros((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            own = count[i + 1, j + 1]
            if own > _FEWEST_HOT:
                around = count[i : i + 3, j : j + 3].sum() - own
                hot[i, j] = own > _FEWEST_HOT + _SHARE_OF_NEIGHBOURS * around
    return hot


@njit(nogil=True)
def _cool(
    x: NDArray[np.uint16], y: NDArray[np.uint16], hot: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Mask (N,) of the events that are not of hot pixels (height, width)."""
    cool = np.empty(len(x), np.bool_)
    for k in range(len(x)):
        cool[k] = not hot[y[k], x[k]]
    return cool


def without_flicker(events: Events, width: int, height: int) -> Events:
    """Leave out the events of the blocks of 16 x 16 pixels that flicker.

    A lamp on mains of 50 or 60 Hz brightens and dims 100 or 120 times a second. Where its light
    falls, all pixels fire ON together and OFF half a period later. An edge that moves fires once,
    or at times that do not follow the mains.

    The measure is |sum p exp(-2 pi i f t)| / n over the n events of a block, with p = +-1: near 1
    where the light flickers, about 1 / sqrt(n) where edges move.

    Args:
        events: on the sensor, of at least 20 ms; shorter ones are returned as they are.
        width, height: of the sensor in pixels.
    """
    if not len(events):
        return events
    some = spread_places(events, len(events) // max(1, len(events) // _LAMP_SAMPLE))
    if (events.t[some[-1]] - events.t[some[0]]) * 1e-9 < _SHORTEST_LAMP_S:
        return events
    columns, rows = -(-width // _LAMP_BLOCK), -(-height // _LAMP_BLOCK)
    flickers = _flickering(events.x, events.y, events.t, events.p, some, columns, columns * rows)
    if not flickers.any():
        return events
    return events[~flickers[_lamp_blocks(events, width)]]


@njit(nogil=True)
def _flickering(
    x: NDArray[np.uint16], y: NDArray[np.uint16], t: NDArray[np.int64], on: NDArray[np.bool_],
    chosen: NDArray[np.intp], columns: int, count: int,
) -> NDArray[np.bool_]:  # fmt: skip
    """Tell which of `count` blocks, in so many columns, flicker; see `without_flicker`.

    They have to flicker in each part of the time. The chosen events (N,) are sorted by time, and
    lie on the sensor.
    """
    block, end = np.empty(len(chosen), np.int32), np.zeros(_LAMP_PARTS + 1, np.int64)
    seconds = ((t[chosen] - t[chosen[0]]) * 1e-9).astype(np.float32)
    number = np.zeros((_LAMP_PARTS, count), np.int32)
    for n, k in enumerate(chosen):
        block[n] = (y[k] // _LAMP_BLOCK) * columns + x[k] // _LAMP_BLOCK
        part = min(int(seconds[n] * (_LAMP_PARTS / seconds[-1])), _LAMP_PARTS - 1)
        number[part, block[n]] += 1
        end[part + 1] = n + 1
    # After a part without events the next one would begin at 0: but then no block is certain.
    flickers = np.zeros(count, np.bool_)
    for frequency in MAINS_HZ:
        certain = np.ones(count, np.bool_)
        for of_part in number:
            certain &= of_part >= _CERTAIN
        for p in range(_LAMP_PARTS):  # few blocks are left after the first
            wave = np.zeros((count, 2))
            for n in range(end[p], end[p + 1]):
                if certain[block[n]]:
                    phase = int(frequency * seconds[n] * len(_WAVE)) % len(_WAVE)
                    sign = 1.0 if on[chosen[n]] else -1.0
                    wave[block[n], 0] += sign * _WAVE[phase, 0]
                    wave[block[n], 1] += sign * _WAVE[phase, 1]
            for i in range(count):
                if certain[i]:
                    held, squared = number[p, i], wave[i, 0] ** 2 + wave[i, 1] ** 2
                    certain[i] = squared > max(_CERTAIN * held, (_COHERENT * held) ** 2)
        flickers |= certain
    return flickers


def _lamp_blocks(events: Events, width: int) -> NDArray[np.intp]:
    """Index of the block (N,) that each event lies in."""
    columns = -(-width // _LAMP_BLOCK)
    return (events.y // _LAMP_BLOCK).astype(np.intp) * columns + events.x // _LAMP_BLOCK
