"""Slices of the stream drawn as signed images, each event moved to the slice's middle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.slice_kernels import draw_signed, halve, slope
from emoflow_ros.core.lattice.field_kernels import bilinear
from emoflow_ros.core.numerics.smoothing import gaussian, outwards

F32 = NDArray[np.float32]

GRID_PX = 8  # distance of the nodes of a slice's flow, px of the working image
_TAPS = outwards(gaussian(0.8))


@dataclass(frozen=True)
class SliceEvents:
    """Events of one slice in the pixels of the working image.

    Attributes:
        t: the slice's middle, ns.
        x, y: (N,) px.
        dt: (N,) time from the event to the slice's middle, s.
        sign: (N,) +1 for ON, -1 for OFF.
    """

    t: int
    x: F32
    y: F32
    dt: F32
    sign: F32


@dataclass(frozen=True)
class Picture:
    """An image at one scale with its slopes, (h, w) each."""

    image: F32
    along_x: F32
    along_y: F32

    @classmethod
    def of(cls, image: F32) -> "Picture":
        """Take the slopes of an image by central differences."""
        return cls(image, *slope(image))


@dataclass(frozen=True)
class Slice:
    """What a slice of events looks like at its middle.

    Attributes:
        t: its middle, ns.
        full, half: at full and at half resolution. Pixel (x, y) of the half lies at
            (2 x + 0.5, 2 y + 0.5) of the full.
        flow: (rows, columns, 2) px/s, that the events were moved along, at nodes GRID_PX apart.
    """

    t: int
    full: Picture
    half: Picture
    flow: F32

    @classmethod
    def of(cls, t: int, image: F32, flow: F32) -> "Slice":
        """Look at a drawn image (h, w) at both scales."""
        return cls(t, Picture.of(image), Picture.of(halve(image)), flow)


def grid_nodes(size: tuple[int, int]) -> NDArray[np.float64]:
    """Nodes (rows, columns, 2) px of a flow that cover an image; the last ones on its border.

    Args:
        size: width and height of the image.
    """
    x, y = (np.arange(-(-(side - 1) // GRID_PX) + 1) * float(GRID_PX) for side in size)
    return np.minimum(np.stack(np.meshgrid(x, y), axis=-1), np.array(size) - 1.0)


def flow_at(flow: F32, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Interpolate a slice's flow (rows, columns, 2) at points (N, 2) px."""
    per_px = np.full(2, 1.0 / GRID_PX, np.float32)
    nodes = np.ascontiguousarray(flow.transpose(1, 0, 2), np.float64)
    return np.asarray(bilinear(nodes, points, per_px))


def drawn(events: SliceEvents, flow: F32, size: tuple[int, int]) -> F32:
    """Draw events moved along a flow to the slice's middle, (h, w).

    Args:
        events: of the slice.
        flow: (rows, columns, 2) px/s at nodes GRID_PX apart.
        size: width and height of the working image.
    """
    return draw_signed(
        events.x, events.y, events.dt, events.sign, flow, GRID_PX, size[0], size[1], _TAPS
    )


def sharpness(image: F32) -> float:
    """Sum of the squares of an image."""
    return float(np.vdot(image, image))
