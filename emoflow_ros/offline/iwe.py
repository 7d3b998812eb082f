"""Images of warped events, for people to look at."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.estimate import FlowSampler
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import Window

_INTERVALS = 16

Image = NDArray[np.float64]


def event_image(events: Events, width: int, height: int) -> Image:
    """Count the events per pixel, (height, width): the image of unwarped events."""
    return _vote(events.x.astype(np.float64), events.y.astype(np.float64), width, height)


def warped_image(
    window: Window, flow: FlowSampler, reference: int, width: int, height: int
) -> Image:
    """Count the events per pixel after moving them along the flow to time `reference` (ns).

    The displacement is taken from the flow at 17 times and is linear in between.

    Returns:
        (height, width), by bilinear voting.
    """
    events = window.events
    times = np.linspace(window.t_start, window.t_end, _INTERVALS + 1).astype(np.int64)
    interval = np.clip(np.searchsorted(times, events.t, side="right") - 1, 0, _INTERVALS - 1)
    moved = np.empty((len(events), 2))
    before = flow.displacement(int(times[0]), reference)
    for i in range(_INTERVALS):
        after = flow.displacement(int(times[i + 1]), reference)
        mine = interval == i
        at = events.y[mine], events.x[mine]
        share = (events.t[mine] - times[i]) / (times[i + 1] - times[i])
        moved[mine] = before[at] + share[:, None] * (after[at] - before[at])
        before = after
    return _vote(events.x + moved[:, 0], events.y + moved[:, 1], width, height)


def _vote(x: Image, y: Image, width: int, height: int) -> Image:
    """Spread each point over its four pixels; what falls outside is dropped."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    left, top = np.floor(x).astype(np.intp), np.floor(y).astype(np.intp)
    image = np.zeros(width * height)
    for column, weight_x in ((left, left + 1 - x), (left + 1, x - left)):
        for row, weight_y in ((top, top + 1 - y), (top + 1, y - top)):
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            cell = row[inside] * width + column[inside]
            weights = (weight_x * weight_y)[inside]
            image += np.bincount(cell, weights, minlength=width * height)
    return image.reshape(height, width)
