"""Events of hot pixels: single pixels that fire on and on, whatever is before them."""

import numpy as np

from emoflow_ros.core.events import Events

_FEWEST = 5  # events above what the neighbours explain
_SHARE = 0.5  # of the events of its eight neighbours that a pixel may have besides


def without_hot_pixels(events: Events, width: int, height: int) -> Events:
    """Leave out the pixels that fire far more often than their eight neighbours together explain.

    An edge crosses neighbouring pixels alike. A hot pixel fires alone; all its events lie at one
    place, so that it holds the flow around it at zero.

    Args:
        events: on the sensor.
        width, height: of the sensor in pixels.
    """
    columns = width + 2  # a frame of one pixel spares the border's cases
    pixel = (events.y.astype(np.intp) + 1) * columns + events.x + 1
    count = np.bincount(pixel, minlength=columns * (height + 2))
    often = np.flatnonzero(count > _FEWEST)
    around = sum(
        count[often + dy * columns + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx
    )
    hot = np.zeros(len(count), np.bool_)
    hot[often] = count[often] > _FEWEST + _SHARE * around
    return events[~hot[pixel]] if hot.any() else events
