"""Contrast of the image of warped events, with its derivatives on the lattice.

The image sums the events' polarities, each divided by the square root of the event density
around it, so that weak and strong texture count alike and events of unlike polarity do not
attract each other. The contrast is half the sum of the squares of the smoothed image: a
variance (Gallego et al., CVPR 2018), as signed polarities have mean zero.

A fit climbs the part of it that tells motion: the products of images of different quarters of the
window. Within a quarter events lie close together whatever the flow, most of all those of noise.
"""

from collections.abc import Callable
from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core import derivatives, kernels
from emoflow_ros.core.cells import Cells
from emoflow_ros.core.lattice import Lattice, material_derivative
from emoflow_ros.core.smoothing import gaussian, outwards, smooth
from emoflow_ros.core.window_events import PARTS, CellEvents, WindowEvents

PAIRS = PARTS / (PARTS - 1)  # all pairs of events over the pairs of events from different parts
SIGMA = 1.0  # of the Gaussian that smooths the image, image pixels
STIFFNESS_STRIDE = 4  # events per event whose stiffness is computed: that is the most costly part

F32 = NDArray[np.float32]
I32 = NDArray[np.int32]

_compiled = numba.njit(cache=True, nogil=True)


class ImageContrast(Protocol):
    """A contrast as the lattice fit takes it, wherever it is computed; see Contrast."""

    @property
    def lattice(self) -> Lattice:
        """Of the flow."""
        ...

    @property
    def scale(self) -> float:
        """Image pixels per sensor pixel."""
        ...

    def score(self, events: WindowEvents, u: float, v: float) -> float:
        """Contrast of events warped to the middle by a constant flow, px per window."""
        ...

    def gain(self, events: WindowEvents, flow: F32) -> float:
        """Contrast of the warped events over that of the events as they came."""
        ...

    def linearise(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> Cells:
        """Gradient and curvature of the contrast between the window's parts.

        They hold until the next call.
        """
        ...


type ContrastFactory = Callable[[Lattice, float], ImageContrast]


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
        taps = gaussian(SIGMA)
        self._taps, self._taps_twice = outwards(taps), outwards(np.convolve(taps, taps))
        margin = 2 * kernels.MARGIN
        shape = tuple(int((n + margin) * scale) + 1 for n in (lattice.height, lattice.width))
        self.image = np.zeros(shape, np.float32)
        self._parts = np.zeros((PARTS, *shape), np.float32)
        self._cells = Cells.empty(lattice.columns, lattice.rows)

    def sharpen(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> float:
        """Draw the smoothed image of the events warped to `ref`, and return its contrast."""
        per_px = self.lattice.per_px
        return self._area * _sharpen(
            *events.on(self.lattice), ref, flow, per_px, self.scale, self._taps, self.image
        )

    def score(self, events: WindowEvents, u: float, v: float) -> float:
        """Contrast of events warped to the middle by a constant flow, px per window."""
        return self._area * _shift(
            events.x, events.y, events.s, events.weights, u, v, self.scale, self._taps, self.image
        )

    def gain(self, events: WindowEvents, flow: F32) -> float:
        """Contrast of the warped events over that of the events as they came.

        0 where the latter is 0, because as many events of either polarity lie at each pixel.
        """
        sharp = self.sharpen(events, flow)
        as_came = self.score(events, 0.0, 0.0)
        return sharp / as_came if as_came > 0 else 0.0

    def linearise(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> Cells:
        """Gradient and curvature of the contrast between the window's parts.

        They hold until the next call. With the images I_a of n parts they are those of
        n / (n - 1) sum_(a < b) I_a . I_b: the contrast of all events without what each part's
        events make of it among themselves. Seen from the middle of the window the image of all
        events stays in place while the flow changes, so that the events' stiffness alone is the
        right curvature. The image of the other parts moves against an event: by another
        1 / (n - 1).
        """
        slope = self._area * PAIRS
        _linearise(
            *events.on(self.lattice), ref, flow, self.lattice.per_px, self.scale, self._taps_twice,
            slope, self._parts, *self._cells,
        )  # fmt: skip
        return self._cells


@_compiled
def _draw(position: F32, weights: F32, scale: float, taps: F32, image: F32) -> float:
    """Draw the smoothed image of events at positions (2, N) px; half the sum of its squares."""
    images = image.reshape((1, *image.shape))
    kernels.vote(position, weights, np.zeros(len(weights), np.int32), scale, images)
    smooth(images, taps)
    return 0.5 * _sum_of_squares(image.ravel())


@_compiled
def _shift(
    x: F32, y: F32, s: F32, weights: F32, u: float, v: float, scale: float, taps: F32, image: F32
) -> float:  # fmt: skip
    """Draw the smoothed image of events warped by a constant flow; half the sum of its squares."""
    position = np.empty((2, len(x)), np.float32)
    by_x, by_y, half = np.float32(u), np.float32(v), np.float32(0.5)
    for k in range(len(x)):
        position[0, k] = x[k] + (half - s[k]) * by_x
        position[1, k] = y[k] + (half - s[k]) * by_y
    return _draw(position, weights, scale, taps, image)


@numba.njit(cache=True, fastmath=True, nogil=True)
def _sum_of_squares(values: F32) -> float:
    total = np.float32(0)
    for k in range(len(values)):
        total += values[k] * values[k]
    return float(total)


@_compiled
def _sharpen(
    x: F32, y: F32, right: F32, down: F32, s: F32, weights: F32, part: I32, begin: I32,
    ref: float, flow: F32, per_px: F32, scale: float, taps: F32, image: F32,
) -> float:  # fmt: skip
    """Draw the smoothed image of warped CellEvents; half the sum of its squares."""
    events = CellEvents(x, y, right, down, s, weights, part, begin)
    return _draw(_warp(events, ref, flow, per_px), weights, scale, taps, image)


@_compiled
def _warp(events: CellEvents, ref: float, flow: F32, per_px: F32) -> F32:
    acceleration = np.empty((flow.shape[0], flow.shape[1], 2), np.float32)
    material_derivative(flow, per_px, acceleration)
    position = np.empty((2, len(events.s)), np.float32)
    kernels.warp(events, ref, flow, acceleration, position)
    return position


@_compiled
def _linearise(
    x: F32, y: F32, right: F32, down: F32, s: F32, weights: F32, part: I32, begin: I32,
    ref: float, flow: F32, per_px: F32, scale: float, taps: F32, slope: float,
    images: F32, gradient: F32, curvature: F32,
) -> None:  # fmt: skip
    """Compute gradient and curvature, all in one call: each call takes microseconds by itself.

    Args:
        x, y, right, down, s, weights, part, begin: fields of CellEvents.
        ref, flow: see `Contrast.linearise`.
        per_px, scale, taps: of the lattice, of the images, and of their smoothing, twice.
        slope: factor of the gradient.
        images: (PARTS, h, w), overwritten.
        gradient, curvature: of Cells, overwritten.
    """
    events = CellEvents(x, y, right, down, s, weights, part, begin)
    position = _warp(events, ref, flow, per_px)
    kernels.vote(position, weights, part, scale, images)
    smooth(images, taps)
    kernels.without_own(images)  # now what the other parts draw
    derivatives.pull(events, ref, position, images, scale, slope, gradient)
    derivatives.stiffen(
        events, ref, position, images, scale, STIFFNESS_STRIDE, slope * PAIRS, curvature
    )


def best_constant_flow(contrast: ImageContrast, events: WindowEvents, reach: float) -> F32:
    """Search the constant flow of highest contrast, (2,) px per window.

    Args:
        contrast: at a coarse scale.
        events: a few thousand suffice.
        reach: largest displacement per window that is tried, px.
    """

    def score(flow: tuple[float, float]) -> float:
        return contrast.score(events, *flow)

    step = 2.0 / contrast.scale
    most = int(reach / step)
    steps = [k * step for k in range(-most, most + 1)]
    best = max(((u, v) for u in steps for v in steps), key=score)
    while step > 1.0:
        step /= 2
        around = (-step, 0.0, step)
        best = max(((best[0] + a, best[1] + b) for a in around for b in around), key=score)
    return np.array(best, np.float32)
