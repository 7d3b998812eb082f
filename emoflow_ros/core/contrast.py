"""Contrast of the image of warped events, with its derivatives on the lattice.

The image sums the events' polarities, each divided by the square root of the event density
around it, so that weak and strong texture count alike and events of unlike polarity do not
attract each other. The contrast is half the sum of the squares of the smoothed image: a
variance (Gallego et al., CVPR 2018), as signed polarities have mean zero.

A fit climbs the part of it that tells motion: the products of images of different quarters of the
window. Within a quarter events lie close together whatever the flow, most of all those of noise.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core import derivatives, kernels
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.normal_equations import gather_cells

PARTS = 4  # parts of the window whose images are compared
PAIRS = PARTS / (PARTS - 1)  # all pairs of events over the pairs of events from different parts
SIGMA = 1.0  # of the Gaussian that smooths the image, image pixels
STIFFNESS_STRIDE = 4  # events per event whose stiffness is computed: that is the most costly part

_DENSITY_CELL = 4  # side of the cells in which density is counted, px
_DENSITY_SIGMA = 2.0  # standard deviation of the density's smoothing, cells
_DENSITY_FLOOR = 0.1  # share of the mean density that is added: lone events stay weak

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class WindowEvents:
    """Events of one window as the kernels take them.

    Attributes:
        x, y: (N,) px.
        s: (N,) time in [0, 1] over the window.
        weights: (N,) polarity (+-1) over the square root of the density around.
    """

    x: F32
    y: F32
    s: F32
    weights: F32

    @classmethod
    def prepare(cls, x: F32, y: F32, s: F32, on: NDArray[np.bool_]) -> "WindowEvents":
        """Weigh events by their polarity and density."""
        column = x.astype(np.intp) // _DENSITY_CELL
        row = y.astype(np.intp) // _DENSITY_CELL
        columns, rows = int(column.max()) + 1, int(row.max()) + 1
        cell = row * columns + column
        count = np.bincount(cell, minlength=rows * columns).reshape(rows, columns)
        density = count.astype(np.float32)
        taps = gaussian(_DENSITY_SIGMA)
        support = np.ones_like(density)
        smooth(density, taps)
        smooth(support, taps)
        density = density / support + np.float32(_DENSITY_FLOOR * count.mean())
        size = _DENSITY_CELL / np.sqrt(density.ravel()[cell])
        return cls(x, y, s, np.where(on, size, -size).astype(np.float32))

    def every(self, step: int) -> "WindowEvents":
        """Thin out to each step-th event; the weights make up for it."""
        x, y, s, weights = (
            np.ascontiguousarray(c[::step]) for c in (self.x, self.y, self.s, self.weights)
        )
        return WindowEvents(x, y, s, weights * np.float32(np.sqrt(step)))

    def between(self, begin: float, end: float) -> "WindowEvents":
        """Take the events of a part of the window, times in [0, 1]."""
        return self.at((self.s >= begin) & (self.s <= end))

    def at(self, chosen: NDArray[np.bool_]) -> "WindowEvents":
        """Take the events of a mask (N,)."""
        return WindowEvents(*(c[chosen] for c in (self.x, self.y, self.s, self.weights)))

    def __len__(self) -> int:
        return len(self.x)


class ImageContrast(Protocol):
    """A contrast as the lattice fit takes it, wherever it is computed; see Contrast."""

    @property
    def scale(self) -> float:
        """Image pixels per sensor pixel."""
        ...

    def score(self, events: WindowEvents, position: F32) -> float:
        """Contrast of events at given positions (2, N) px."""
        ...

    def gain(self, events: WindowEvents, flow: F32) -> float:
        """Contrast of the warped events over that of the events as they came."""
        ...

    def linearise(
        self,
        events: WindowEvents,
        flow: F32,
        vector: NDArray[np.float64],
        band: NDArray[np.float64],
        ref: float = 0.5,
    ) -> None:
        """Add gradient and curvature of the contrast between the window's parts."""
        ...


type ContrastFactory = Callable[[Lattice, float], ImageContrast]


def gaussian(sigma: float) -> F32:
    """Sampled Gaussian with sum 1, to 2.5 sigma on either side."""
    reach = int(np.ceil(2.5 * sigma))
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return (taps / taps.sum()).astype(np.float32)


def smooth(image: F32, taps: F32) -> None:
    """Convolve an image (h, w) along rows and columns, in place; zero outside.

    Args:
        image: (h, w).
        taps: symmetric, 13 at most.
    """
    middle = len(taps) // 2
    outwards = np.zeros(kernels.REACH + 1, np.float32)
    outwards[: middle + 1] = taps[middle:]
    kernels.smooth(image, outwards)


class Contrast:
    """The contrast at one image scale, and the buffers that it needs.

    Args:
        lattice: the flow field's lattice.
        scale: image pixels per sensor pixel.
    """

    def __init__(self, lattice: Lattice, scale: float) -> None:
        self.lattice = lattice
        self.scale = scale
        self._area = scale**2  # makes contrasts of all scales alike
        self._taps = gaussian(SIGMA)
        self._taps_twice = np.convolve(self._taps, self._taps)
        margin = 2 * kernels.MARGIN
        shape = tuple(int((n + margin) * scale) + 1 for n in (lattice.height, lattice.width))
        self.image = np.zeros(shape, np.float32)
        self._parts = np.zeros((PARTS, *shape), np.float32)
        cells = (lattice.columns - 1, lattice.rows - 1, lattice.times - 1)
        self._gradient = np.zeros((*cells, 2, 8), np.float32)
        self._curvature = np.zeros((*cells, 8, 3, 8), np.float32)

    def sharpen(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> tuple[float, F32]:
        """Draw the smoothed image of the events warped to `ref` into `self.image`.

        Returns:
            The contrast and the warped positions (2, N) px.
        """
        position = self._warp(events, flow, ref)
        return self.score(events, position), position

    def score(self, events: WindowEvents, position: F32) -> float:
        """Contrast of events at given positions (2, N) px."""
        kernels.vote(position, events.weights, self.scale, self.image[None])
        smooth(self.image, self._taps)
        flat = self.image.ravel()
        return 0.5 * self._area * float(flat @ flat)

    def gain(self, events: WindowEvents, flow: F32) -> float:
        """Contrast of the warped events over that of the events as they came.

        0 where the latter is 0, because as many events of either polarity lie at each pixel.
        """
        sharp, _ = self.sharpen(events, flow)
        as_came = self.score(events, np.stack([events.x, events.y]))
        return sharp / as_came if as_came > 0 else 0.0

    def linearise(
        self,
        events: WindowEvents,
        flow: F32,
        vector: NDArray[np.float64],
        band: NDArray[np.float64],
        ref: float = 0.5,
    ) -> None:
        """Add gradient and curvature of the contrast between the window's parts.

        With the images I_a of n parts, n / (n - 1) sum_(a < b) I_a . I_b: the contrast of all
        events without what each part's events make of it among themselves. Seen from the middle
        of the window the image of all events stays in place while the flow changes, so that the
        events' stiffness alone is the right curvature. The image of the other parts moves
        against an event: by another 1 / (n - 1).
        """
        position = self._warp(events, flow, ref)
        parts = self._parts
        kernels.vote(position, events.weights, self.scale, parts)
        for image in parts:
            smooth(image, self._taps_twice)
        kernels.without_own(parts)  # now what the other parts draw
        self._gradient[:] = 0.0
        self._curvature[:] = 0.0
        drawn = (
            events.x, events.y, events.s, events.weights, ref, position,
            parts, self.scale, self.lattice.per_px,
        )  # fmt: skip
        derivatives.pull(*drawn, self._gradient)
        derivatives.stiffen(*drawn, STIFFNESS_STRIDE, self._curvature)
        slope = self._area * PAIRS
        gather_cells(self._gradient, self._curvature, slope, slope * PAIRS, vector, band)

    def _warp(self, events: WindowEvents, flow: F32, ref: float) -> F32:
        position = np.empty((2, len(events)), np.float32)
        acceleration = self.lattice.acceleration(flow)
        kernels.warp(
            events.x, events.y, events.s, ref, flow, acceleration,
            self.lattice.per_px, position,
        )  # fmt: skip
        return position


def best_constant_flow(contrast: ImageContrast, events: WindowEvents, reach: float) -> F32:
    """Search the constant flow of highest contrast, (2,) px per window.

    Args:
        contrast: at a coarse scale.
        events: a few thousand suffice.
        reach: largest displacement per window that is tried, px.
    """
    position = np.empty((2, len(events)), np.float32)
    lever = np.float32(0.5) - events.s

    def score(flow: tuple[float, float]) -> float:
        position[0] = events.x + lever * np.float32(flow[0])
        position[1] = events.y + lever * np.float32(flow[1])
        return contrast.score(events, position)

    step = 2.0 / contrast.scale
    steps = np.arange(-int(reach / step), int(reach / step) + 1) * step
    best = max(((u, v) for u in steps for v in steps), key=score)
    while step > 1.0:
        step /= 2
        around = (-step, 0.0, step)
        best = max(((best[0] + a, best[1] + b) for a in around for b in around), key=score)
    return np.array(best, np.float32)
