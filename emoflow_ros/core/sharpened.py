"""Pictures of a window's warped events, for people to look at."""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.estimate import FlowSampler
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import Window

_SLICES = 32  # the events of one are moved alike: an error of 1/64 of the window's motion
_MOST_EVENTS = 60_000
_WHITE = 0.99  # quantile of the pixels with events that is shown white


def sharpened_events(
    window: Window, flow: FlowSampler, t: int, width: int, height: int
) -> NDArray[np.uint8]:
    """Draw the events where the flow carries them at time t (ns).

    Windows of more than 60 000 events are thinned evenly, so that the time this takes is bounded.

    Returns:
        (height, width), black without events, white at their 99th percentile per pixel.
    """
    thinned = Window(window.t_start, window.t_end, _thinned(window.events))
    counts = warped_counts(thinned, flow, t, width, height)
    white = np.quantile(counts[counts > 0], _WHITE) if counts.any() else 1.0
    return np.rint(np.minimum(counts / white, 1) * 255).astype(np.uint8)


def warped_counts(
    window: Window, flow: FlowSampler, t: int, width: int, height: int
) -> NDArray[np.int64]:
    """Count the events per pixel where the flow carries them at time t (ns), (height, width).

    Each goes to its nearest pixel; those that leave the image are not counted.
    """
    moved = _carried(window.events, window, flow, t)
    moved = np.rint(moved[np.isfinite(moved).all(axis=1)]).astype(np.int64)
    x, y = moved[((moved >= 0) & (moved < (width, height))).all(axis=1)].T
    return np.bincount(y * width + x, minlength=width * height).reshape(height, width)


def _thinned(events: Events) -> Events:
    return events[:: -(-len(events) // _MOST_EVENTS)] if len(events) else events


def _carried(events: Events, window: Window, flow: FlowSampler, t: int) -> NDArray[np.float64]:
    """Move the events (N, 2) along the flow, those of each slice of the window together."""
    points = np.stack([events.x, events.y], axis=1).astype(np.float64)
    edges = np.linspace(window.t_start, window.t_end, _SLICES + 1).astype(np.int64)
    bounds = np.searchsorted(events.t, edges)
    for i in range(_SLICES):
        mine = slice(bounds[i], bounds[i + 1])
        middle = int(edges[i] + edges[i + 1]) // 2
        if mine.start < mine.stop:
            points[mine] = flow.tracks(points[mine], (middle, t))[1]
    return points
