"""Preparation of a window's events for the lattice fit, in the pixels of a working image.

Events of hot pixels and of flickering lamps are left out of whole windows, before the motion
decides which part of a window is estimated. The part's events are then thinned and moved to the
working image.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate, Estimator
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.jit import njit
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.thinning import spread_places
from emoflow_ros.core.window_events import WindowEvents

F32 = NDArray[np.float32]

# Longer side of the working image of a large sensor, px. Options in pixels are meant for an image
# of this size. Smaller sensors keep their pixels.
_LONGER_SIDE_PX = 346

_SHORTEST_SPREAD = 0.1  # share of the window between the first and the last tenth of the events
_BLOCK = 8  # side of a block, px
_FEWEST_BLOCKS = 16  # number of blocks that must hold events

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


@dataclass(frozen=True)
class WorkingImage:
    """The image that an estimator works on: that of a DAVIS346, whatever the sensor.

    Texture, blur and errors of the flow are measured in pixels. On a sensor of twice as many
    pixels the same scene takes twice the pixels, and every option in pixels would have to follow.
    So the events are moved to an image of about 346 x 260 pixels, without rounding, and the flow
    back. The time that a window takes then does not depend on the sensor, either.

    Attributes:
        sensor: the camera as it is.
        camera: the same with the pixels of the working image.
    """

    sensor: Camera
    camera: Camera

    @classmethod
    def of(cls, sensor: Camera) -> "WorkingImage":
        """Choose the working image of a sensor."""
        ratio = reduction(sensor)
        if ratio == 1.0:
            return cls(sensor, sensor)
        width, height = (max(2, round((n - 1) / ratio) + 1) for n in sensor.size)
        return cls(sensor, sensor.resized(width, height))

    @property
    def sensor_px(self) -> NDArray[np.float32]:
        """Pixels of the sensor per pixel of the working image in x and y, (2,)."""
        sensor, camera = np.array(self.sensor.size), np.array(self.camera.size)
        return ((sensor - 1) / (camera - 1)).astype(np.float32)

    def on_sensor(
        self, lattice: Lattice, flow: NDArray[np.float32]
    ) -> tuple[Lattice, NDArray[np.float32]]:
        """Bring a lattice and its field (columns, rows, times, 2) to the sensor's pixels."""
        if self.camera is self.sensor:
            return lattice, flow
        nodes = Lattice(*self.sensor.size, lattice.columns, lattice.rows, lattice.times)
        return nodes, flow * self.sensor_px


def reduction(sensor: Camera) -> float:
    """Sensor pixels per pixel of the working image, 1 for sensors that are no larger."""
    return max(1.0, (max(sensor.size) - 1) / (_LONGER_SIDE_PX - 1))


def prepare(window: Window, image: WorkingImage, config: LatticeConfig) -> WindowEvents | None:
    """Take a window's events, in the order of time, to the working image, thinned to max_events.

    Returns:
        None if they are too few, or one burst without the time that motion needs, or all on
        a few pixels without the place that it needs.

    Raises:
        ValueError: events lie outside the window's interval, where the flow has no nodes.
    """
    events = window.events
    if len(events) < config.min_events:
        return None
    first, last = int(events.t[0]), int(events.t[-1])
    if not window.t_start <= first <= last <= window.t_end or window.t_start == window.t_end:
        raise ValueError("a window's events have to lie between t_start and t_end")
    x, y, s, on, blocks = _to_working_image(
        events.x, events.y, events.t, events.p, spread_places(events, config.max_events),
        window.t_start, window.t_end, image.sensor_px, *image.camera.size,
    )  # fmt: skip
    if s[9 * len(s) // 10] - s[len(s) // 10] < _SHORTEST_SPREAD or blocks < _FEWEST_BLOCKS:
        return None
    return WindowEvents.prepare(x, y, s, on)


@njit(nogil=True)
def _to_working_image(
    x: NDArray[np.uint16], y: NDArray[np.uint16], t: NDArray[np.int64], on: NDArray[np.bool_],
    chosen: NDArray[np.intp], start: int, end: int, sensor_px: F32, width: int, height: int,
) -> tuple[F32, F32, F32, NDArray[np.bool_], int]:  # fmt: skip
    """Bring chosen events (N,) to the working image, and the time to [0, 1]; count filled blocks.

    Returns:
        x, y, s and polarity (N,); the number of blocks that hold events.
    """
    columns, rows = width // _BLOCK + 1, height // _BLOCK + 1
    seen = np.zeros((rows, columns), np.bool_)
    px, py, s = np.empty((3, len(chosen)), np.float32)
    for n, k in enumerate(chosen):
        s[n] = (t[k] - start) / (end - start)
        px[n], py[n] = np.float32(x[k]) / sensor_px[0], np.float32(y[k]) / sensor_px[1]
        # Numba checks no bounds; an event off the sensor counts for the block at the border.
        seen[min(int(py[n]) // _BLOCK, rows - 1), min(int(px[n]) // _BLOCK, columns - 1)] = True
    return px, py, s, on[chosen], seen.sum()


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
    return events[~hot[events.y, events.x]] if hot.any() else events


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
