"""Events of a window as the lattice fit takes them, or none if they cannot show motion."""

import numpy as np

from emoflow_ros.core.contrast import WindowEvents
from emoflow_ros.core.flicker import without_flicker
from emoflow_ros.core.hot_pixels import without_hot_pixels
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.windows import Window
from emoflow_ros.core.working_image import WorkingImage

_SHORTEST_SPREAD = 0.1  # windows between the first and the last tenth of the events
_BLOCK = 8  # px
_FEWEST_BLOCKS = 16  # that hold events


def prepare(window: Window, image: WorkingImage, config: LatticeConfig) -> WindowEvents | None:
    """Take a window's events to the working image, thinned evenly to max_events.

    Events of hot pixels and of flickering lamps are left out first.

    Returns:
        None if they are too few, or one burst without the time that motion needs, or all on
        a few pixels without the place that it needs.
    """
    events = window.events
    inside = events.inside(*image.sensor.size)
    if not inside.all():
        events = events[inside]
    events = without_hot_pixels(events, *image.sensor.size)
    events = without_flicker(events, *image.sensor.size)
    if len(events) < config.min_events:
        return None
    if len(events) > config.max_events:
        events = events[np.arange(config.max_events) * len(events) // config.max_events]
    s = ((events.t - window.t_start) / (window.t_end - window.t_start)).astype(np.float32)
    if s[9 * len(s) // 10] - s[len(s) // 10] < _SHORTEST_SPREAD:
        return None
    px = image.sensor_px
    x, y = events.x.astype(np.float32) / px[0], events.y.astype(np.float32) / px[1]
    blocks = (y / _BLOCK).astype(np.intp) * image.camera.width + (x / _BLOCK).astype(np.intp)
    if np.count_nonzero(np.bincount(blocks)) < _FEWEST_BLOCKS:
        return None
    return WindowEvents.prepare(x, y, s, events.p)
