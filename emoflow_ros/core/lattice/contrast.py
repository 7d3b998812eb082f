"""Contrast of the image of warped events, with its derivatives on the lattice.

The image sums the events' polarities, each divided by the square root of the event density
around it, so that weak and strong texture count alike and events of unlike polarity do not
attract each other. The contrast is half the sum of the squares of the smoothed image: a
variance (Gallego et al., CVPR 2018), as signed polarities have mean zero.

A fit climbs the part of it that tells motion: the products of images of different quarters of the
window. Within a quarter events lie close together whatever the flow, most of all those of noise.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice import derivatives, kernels
from emoflow_ros.core.lattice.cells import Cells
from emoflow_ros.core.lattice.field import TIMES, Lattice
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import PARTS, WindowEvents
from emoflow_ros.core.numerics.smoothing import outwards

_ROUNDING = 1e-6  # a contrast below this share of another one is float32's rounding of zero
SAMPLING = LATTICE.sampling
# Taps that smooth the image. Bilinear votes have blurred it by a variance of 1/6 already. Both
# together blur like votes and a Gaussian of one pixel in an image of the sensor's pixels.
_SIDE = (SAMPLING**2 * (1 + 1 / 6) - 1 / 6) / 2
TAPS = np.array([_SIDE, 1 - 2 * _SIDE, _SIDE], np.float32)
STIFFNESS_STRIDE = LATTICE.stiffness_stride

F32 = NDArray[np.float32]


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

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave the buffers out, with the image that was drawn last."""
        return Contrast, (self.lattice, self.scale)

    def sharpen(self, events: WindowEvents, flow: F32) -> float:
        """Draw the smoothed image of the events warped to the middle, and return its contrast."""
        squares = kernels.draw(
            events.on(self.lattice), 0.5, flow, self.lattice.per_px, self._zoom, self._taps,
            self.image[None],
        )  # fmt: skip
        return 0.5 * self._area * squares

    def scores(self, events: WindowEvents, flows: F32) -> F32:
        """Contrasts (n,) of events warped to the middle by constant flows (n, 2), px per window."""
        columns = events.x, events.y, events.s, events.weights
        squares: F32 = kernels.draw_shifted(
            *columns, flows, self._zoom, self._taps, self.image[None]
        )
        return 0.5 * self._area * squares

    def linearise(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> Cells:
        """Gradient and curvature of the contrast between the window's parts.

        The arrays are overwritten by the next call. With the images I_a of n parts they are those
        of n / (n - 1) sum_(a < b) I_a . I_b: the contrast of all events without what each part's
        events make of it among themselves. Seen from the middle of the window the image of all
        events stays in place while the flow changes, so that the events' stiffness alone is the
        right curvature. The image of the other parts moves against an event: by another
        1 / (n - 1).
        """
        derivatives.linearise(
            events.on(self.lattice), ref, flow, self.lattice.per_px, self._zoom, self._taps_twice,
            STIFFNESS_STRIDE, self._parts, *self._cells,
        )  # fmt: skip
        return self._cells


def contrast_gain(contrast: Contrast, events: WindowEvents, flow: F32) -> float:
    """Contrast of the warped events over that of the events as they came.

    0 where the latter is 0 but for rounding, because as many events of either polarity lie at each
    pixel.
    """
    sharp = contrast.sharpen(events, flow)
    as_came = float(contrast.scores(events, np.zeros((1, 2), np.float32))[0])
    return sharp / as_came if as_came > _ROUNDING * sharp else 0.0


def best_constant_flow(contrast: Contrast, events: WindowEvents, reach: float) -> F32:
    """Search the constant flow of highest contrast, (2,) px per window.

    Args:
        contrast: at a coarse scale.
        events: a few thousand suffice.
        reach: largest displacement per window that is tried, px.
    """
    step = 2.0 / contrast.scale
    best, most = np.zeros(2, np.float32), int(reach / step)
    while True:
        flows = best + np.float32(step) * _around(most)
        best = flows[contrast.scores(events, flows).argmax()]
        if step <= 1.0:
            return best
        step, most = step / 2, 1


@cache
def _around(most: int) -> F32:
    """Places (n, 2) of a square grid, up to `most` steps from its middle; the array is shared."""
    steps = np.arange(-most, most + 1, dtype=np.float32)
    places = np.stack(np.meshgrid(steps, steps, indexing="ij"), -1).reshape(-1, 2)
    places.setflags(write=False)
    return places
