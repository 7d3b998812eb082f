"""Preparation of a window's events for the fit: thinned, in the pixels of a working image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.stream.thinning import spread_places
from emoflow_ros.core.types.events import Window

F32 = NDArray[np.float32]


_BLOCK = 8  # side of a block, px


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
    def of(cls, sensor: Camera, longer_side_px: int = LATTICE.longer_side_px) -> "WorkingImage":
        """Choose the working image of a sensor, no longer than a number of pixels."""
        ratio = reduction(sensor, longer_side_px)
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


def reduction(sensor: Camera, longer_side_px: int = LATTICE.longer_side_px) -> float:
    """Sensor pixels per pixel of the working image, 1 for sensors that are no larger."""
    return max(1.0, (max(sensor.size) - 1) / (longer_side_px - 1))


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
    burst = s[9 * len(s) // 10] - s[len(s) // 10] < LATTICE.shortest_spread
    if burst or blocks < LATTICE.fewest_blocks:
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
