"""How fast the image moves at most, by the events that a known scene leaves.

An edge leaves events on its way, so that a moving scene leaves many in some places and few in
others; noise leaves them anywhere alike. What the numbers of events in blocks of the image scatter
beyond chance grows with the way that the image has moved. A window whose motion was measured tells
how fast it grows in this scene, and from then on it tells how far the image has moved at most,
where the estimator finds no motion, and at rest, where nothing is left but noise.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.preparation import reduction
from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.products.settings import STREAM
from emoflow_ros.core.types.estimate import Estimate, velocity_at
from emoflow_ros.core.types.events import NS_PER_S, Events, Window

Array = NDArray[np.float64]

_LEVER = 0.19  # mean distance of the image's points from its centre, over width + height


@dataclass(frozen=True)
class Gauge:
    """A scene's scatter of events, by the way that the image moves.

    Attributes:
        camera: whose pixels the events lie on.
        per_px: scatter per px of the working image.
    """

    camera: Camera
    per_px: float

    @classmethod
    def supposed(cls, camera: Camera) -> "Gauge":
        """Take a scene that leaves fewer events than most do: it bounds the speed loosely."""
        side = round(STREAM.block_px * reduction(camera))
        return cls(camera, STREAM.supposed * side**2)

    @classmethod
    def measured(cls, camera: Camera, window: Window, estimate: Estimate) -> "Gauge | None":
        """Gauge the scene of a window whose flow was measured.

        Args:
            camera: whose pixels the events lie on.
            window: its events.
            estimate: of the window, with a flow.

        Returns:
            None where the image moves too little to tell.
        """
        flow = estimate.flow
        assert flow is not None
        columns = np.arange(STREAM.grid_px // 2, camera.width, STREAM.grid_px)
        rows = np.arange(STREAM.grid_px // 2, camera.height, STREAM.grid_px)
        grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(np.float64)
        speed = np.linalg.norm(velocity_at(flow, grid, estimate.t), axis=1)
        px_s = float(np.median(speed)) / reduction(camera)
        seconds = min(
            (estimate.t_end - estimate.t_start) / NS_PER_S, STREAM.way_px / max(px_s, 1e-9)
        )
        part = window.since(estimate.t_end - round(seconds * NS_PER_S))
        per_px = scatter(part.events, camera, surely=True) / max(px_s * seconds, 1e-9)
        if px_s * seconds < STREAM.shortest_px or per_px == 0:
            return None
        return cls(camera, per_px)

    def beside(self, earlier: "Gauge | None") -> "Gauge":
        """Return the mean with that of a window before."""
        if earlier is None:
            return self
        return replace(self, per_px=(self.per_px * earlier.per_px) ** 0.5)

    def speed(self, window: Window) -> float | None:
        """How fast the image moves at most, px/s of the working image; None with too few events.

        Of fast motion only the latest part counts: on a longer way events leave their blocks.
        """
        if not works(window.events):
            return None
        way = scatter(window.events, self.camera, surely=False) / self.per_px
        if way > STREAM.longest_px:
            latest = round(window.duration * NS_PER_S * STREAM.way_px / way)
            part = window.since(window.t_end - latest)
            shorter = window.t_start < part.t_start < part.t_end  # not where all come at once
            later = self.speed(part) if shorter else None
            if later is not None:
                return later
        return max(way / window.duration, STREAM.least_px_s)

    def rotation_covariance(self, speed: float) -> Array:
        """Covariance (3, 3), (rad/s)^2, of w = 0 where the image moves at a speed at most."""
        camera = self.camera
        lever = np.array([camera.fy, camera.fx, _LEVER * (camera.width + camera.height)])
        sigma: Array = speed * reduction(camera) / lever
        return np.diag(sigma**2)

    def rest_covariance(self, speed: float) -> Array:
        """Covariance (6, 6) of (linear, angular) at rest: (m/s)^2 and (rad/s)^2."""
        covariance = np.zeros((6, 6))
        covariance[3:, 3:] = of_w = self.rotation_covariance(speed)
        covariance[:3, :3] = STREAM.depth_m**2 * of_w[0, 0] * np.eye(3)
        return covariance


def scatter(events: Events, camera: Camera, *, surely: bool) -> float:
    """How much the events of an image's blocks scatter beyond chance, in events.

    Args:
        events: on the sensor.
        camera: its size.
        surely: at least, by three standard deviations of the noise, instead of at most, by one.
    """
    number, squares = _in_blocks(events, camera)
    by_chance = squares / len(number)
    error = np.sqrt((by_chance + 2 * by_chance**2) / len(number))
    excess = float(number.var()) - by_chance + (-STREAM.sure * error if surely else error)
    return float(np.sqrt(max(0.0, excess)))


def works(events: Events) -> bool:
    """Tell whether a sensor works: one that sends hardly an event may be blind."""
    return events.came >= STREAM.fewest


def structured(events: Events, camera: Camera) -> bool:
    """Tell whether events show edges. Noise scatters by chance, or, in pairs, by twice that."""
    if len(events) < STREAM.fewest_of_edges:
        return False
    number, squares = _in_blocks(events, camera)
    return float(number.var()) > STREAM.edges * squares / len(number)


def covered(events: Events, camera: Camera) -> float:
    """Share of the image's blocks that hold an event for every fourth pixel at least."""
    side = round(STREAM.block_px * reduction(camera))
    number, _ = _in_blocks(events, camera)
    return float((number >= side**2 / 4).mean())


def _in_blocks(events: Events, camera: Camera) -> tuple[Array, float]:
    """Count the events (N,) of the image's N whole blocks, and sum the squares of their weights."""
    side = round(STREAM.block_px * reduction(camera))
    columns, rows = camera.width // side, camera.height // side
    weights = np.ones(1, np.uint32) if events.stands_for is None else events.stands_for
    number = np.zeros((rows, columns))
    squares = _count(events.x, events.y, weights, events.stands_for is None, side, number)
    return number.ravel(), squares


@njit(nogil=True)
def _count(
    x: NDArray[np.uint16], y: NDArray[np.uint16], weights: NDArray[np.uint32], one_each: bool,
    side: int, number: Array,
) -> float:  # fmt: skip
    """Add weights of events to their blocks (rows, columns); return the sum of the squares."""
    rows, columns = number.shape
    block = np.arange((max(rows, columns) + 1) * side) // side  # to divide is slow
    squares = 0.0
    for k in range(len(x)):
        if y[k] < rows * side and x[k] < columns * side:
            i, j = block[y[k]], block[x[k]]
            weight = 1.0 if one_each else float(weights[k])
            number[i, j] += weight
            squares += weight * weight
    return squares
