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

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core import derivatives, kernels
from emoflow_ros.core.cells import Cells
from emoflow_ros.core.lattice import TIMES, Lattice
from emoflow_ros.core.smoothing import outwards, smooth
from emoflow_ros.core.window_events import PARTS, WindowEvents

_ROUNDING = 1e-6  # a contrast below this share of another one is float32's rounding of zero
PAIRS = PARTS / (PARTS - 1)  # all pairs of events over the pairs of events from different parts
# Pixels of an image of warped events per pixel of the working image, at full resolution. With 1
# events that have not moved lie exactly upon each other, and look sharper than they are.
SAMPLING = 0.6
# Taps that smooth the image. Bilinear votes have blurred it by a variance of 1/6 already. Both
# together blur like votes and a Gaussian of one pixel in an image of the sensor's pixels.
_SIDE = (SAMPLING**2 * (1 + 1 / 6) - 1 / 6) / 2
TAPS = np.array([_SIDE, 1 - 2 * _SIDE, _SIDE], np.float32)
STIFFNESS_STRIDE = 4  # events per event whose stiffness is computed: it is costly, and a mean

F32 = NDArray[np.float32]


class ImageContrast(Protocol):
    """A contrast as the lattice fit takes it, wherever it is computed; see Contrast."""

    @property
    def lattice(self) -> Lattice:
        """Of the flow."""
        ...

    @property
    def scale(self) -> float:
        """Resolution: 1, or a part of it."""
        ...

    def sharpen(self, events: WindowEvents, flow: F32) -> float:
        """Contrast of events warped to the middle by a flow (columns, rows, times, 2)."""
        ...

    def score(self, events: WindowEvents, u: float, v: float) -> float:
        """Contrast of events warped to the middle by a constant flow, px per window."""
        ...

    def linearise(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> Cells:
        """Gradient and curvature of the contrast between the window's parts.

        The arrays are overwritten by the next call.
        """
        ...


type ContrastFactory = Callable[[Lattice, float], ImageContrast]


class Contrast:
    """The contrast at one scale, and the buffers that it needs.

    Args:
        lattice: the flow field's lattice.
        scale: resolution; at 1 an image has SAMPLING pixels per pixel of the working image.

    Raises:
        ValueError: the lattice has not two times.
    """

    def __init__(self, lattice: Lattice, scale: float) -> None:
        if lattice.times != TIMES:
            raise ValueError(f"a contrast needs a lattice of {TIMES} times, not {lattice.times}")
        self.lattice = lattice
        self.scale = scale
        self._zoom = SAMPLING * scale  # pixels per pixel of the working image
        self._area = self._zoom**2  # makes contrasts of all scales alike
        self._taps, self._taps_twice = outwards(TAPS), outwards(np.convolve(TAPS, TAPS))
        height = int(lattice.height * self._zoom) + 2 * kernels.MARGIN + 1
        width = int(lattice.width * self._zoom) + 2 * kernels.MARGIN + 1
        self.image = np.zeros((height, width), np.float32)  # of all events, as drawn last
        self._parts = np.zeros((PARTS, height, width), np.float32)
        self._cells = Cells.empty(lattice.columns, lattice.rows)

    def sharpen(self, events: WindowEvents, flow: F32) -> float:
        """Draw the smoothed image of the events warped to the middle, and return its contrast."""
        return self._draw(self._warp(events, flow, 0.5), events.on(self.lattice).weights)

    def score(self, events: WindowEvents, u: float, v: float) -> float:
        """Contrast of events warped to the middle by a constant flow, px per window."""
        return self._draw(kernels.shift(events.x, events.y, events.s, u, v), events.weights)

    def linearise(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> Cells:
        """Gradient and curvature of the contrast between the window's parts.

        The arrays are overwritten by the next call. With the images I_a of n parts they are those
        of n / (n - 1) sum_(a < b) I_a . I_b: the contrast of all events without what each part's
        events make of it among themselves. Seen from the middle of the window the image of all
        events stays in place while the flow changes, so that the events' stiffness alone is the
        right curvature. The image of the other parts moves against an event: by another
        1 / (n - 1).
        """
        here, images = events.on(self.lattice), self._parts
        position = self._warp(events, flow, ref)
        kernels.vote(position, here.weights, here.part, self._zoom, images)
        smooth(images, self._taps_twice)
        kernels.without_own(images)  # now what the other parts draw
        drawn = (here, ref, position, images, self._zoom)
        slope = self._area * PAIRS
        derivatives.pull(*drawn, slope, self._cells.gradient)
        derivatives.stiffen(*drawn, STIFFNESS_STRIDE, slope * PAIRS, self._cells.curvature)
        return self._cells

    def _warp(self, events: WindowEvents, flow: F32, ref: float) -> F32:
        """Warp events to `ref`, (2, N) px, sorted by the lattice's cells."""
        position = np.empty((2, len(events)), np.float32)
        acceleration = self.lattice.acceleration(flow)
        kernels.warp(events.on(self.lattice), ref, flow, acceleration, position)
        return position

    def _draw(self, position: F32, weights: F32) -> float:
        """Draw the smoothed image of events at positions (2, N) px, and return its contrast."""
        one_image = np.zeros(len(weights), np.int32)
        kernels.vote(position, weights, one_image, self._zoom, self.image[None])
        smooth(self.image[None], self._taps)
        flat = self.image.ravel()
        return 0.5 * self._area * float(flat @ flat)


def contrast_gain(contrast: ImageContrast, events: WindowEvents, flow: F32) -> float:
    """Contrast of the warped events over that of the events as they came.

    0 where the latter is 0 but for rounding, because as many events of either polarity lie at each
    pixel.
    """
    sharp = contrast.sharpen(events, flow)
    as_came = contrast.score(events, 0.0, 0.0)
    return sharp / as_came if as_came > _ROUNDING * sharp else 0.0


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
