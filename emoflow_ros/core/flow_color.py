"""Flow as colour: hue is direction, saturation is length.

The colour circle of Baker et al., "A Database and Evaluation Methodology for Optical Flow",
IJCV 2011: 55 hues, spaced by how well people tell them apart.
"""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

# The circle runs through six colours; the number of steps from each to the next.
_CORNERS = (
    ((255, 0, 0), 15),  # red to yellow
    ((255, 255, 0), 6),  # to green
    ((0, 255, 0), 4),  # to cyan
    ((0, 255, 255), 11),  # to blue
    ((0, 0, 255), 13),  # to magenta
    ((255, 0, 255), 6),  # and back to red
)
_UNKNOWN = 0
_TOO_LONG = 0.75  # colours beyond the longest length are darkened


def color_circle() -> NDArray[np.float64]:
    """Build the 55 colours of the circle, (55, 3) RGB in [0, 1]."""
    parts = []
    for i, (start, steps) in enumerate(_CORNERS):
        end = _CORNERS[(i + 1) % len(_CORNERS)][0]
        ramp = np.arange(steps)[:, None] / steps
        parts.append((1 - ramp) * start + ramp * np.array(end))
    return np.concatenate(parts) / 255


_CIRCLE = color_circle()


def flow_to_rgb(flow: NDArray[np.floating], longest: float | None = None) -> Image:
    """Colour a flow image.

    Right is red, down is yellow, left is cyan-blue, up is violet; still pixels are white and
    pixels that are not finite black.

    Args:
        flow: (H, W, 2), u right and v down, in any unit.
        longest: the length shown in full colour, in the same unit; by default the 99th
            percentile of this image. Longer vectors are darkened.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    known = np.isfinite(flow).all(axis=-1)
    u, v = (np.where(known, flow[..., i], 0.0).astype(np.float64) for i in (0, 1))
    length = np.hypot(u, v)
    if longest is None:
        longest = float(np.percentile(length[known], 99)) if known.any() else 1.0
    radius = length / max(longest, 1e-12)
    position = (np.arctan2(v, u) / (2 * np.pi)) % 1.0 * len(_CIRCLE)
    low = position.astype(np.intp) % len(_CIRCLE)
    weight = (position - np.floor(position))[..., None]
    hue = (1 - weight) * _CIRCLE[low] + weight * _CIRCLE[(low + 1) % len(_CIRCLE)]
    pale = 1 - np.minimum(radius, 1)[..., None] * (1 - hue)
    rgb = np.where((radius > 1)[..., None], hue * _TOO_LONG, pale)
    rgb[~known] = _UNKNOWN
    return np.asarray(np.rint(rgb * 255), np.uint8)


def color_wheel(size: int = 151) -> Image:
    """Draw the legend: a disc of all directions and lengths up to `longest` on white."""
    axis = np.linspace(-1, 1, size)
    u, v = np.meshgrid(axis, axis)
    rgb = flow_to_rgb(np.stack([u, v], -1), 1.0)
    rgb[np.hypot(u, v) > 1] = 255
    return rgb
