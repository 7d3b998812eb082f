"""Events of a window as the lattice fit takes them, or none if they cannot show motion."""

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.contrast import WindowEvents
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.windows import Window

_SHORTEST_SPREAD = 0.1  # windows between the first and the last tenth of the events
_BLOCK = 8  # px
_FEWEST_BLOCKS = 16  # that hold events


def prepare(window: Window, camera: Camera, config: LatticeConfig) -> WindowEvents | None:
    """Take a window's events on the sensor, thinned evenly to max_events.

    Returns:
        None if they are too few, or one burst without the time that motion needs, or all on
        a few pixels without the place that it needs.
    """
    events = window.events
    inside = events.inside(camera.width, camera.height)
    if not inside.all():
        events = events[inside]
    if len(events) < config.min_events:
        return None
    if len(events) > config.max_events:
        events = events[np.arange(config.max_events) * len(events) // config.max_events]
    s = ((events.t - window.t_start) / (window.t_end - window.t_start)).astype(np.float32)
    if s[9 * len(s) // 10] - s[len(s) // 10] < _SHORTEST_SPREAD:
        return None
    blocks = (events.y // _BLOCK).astype(np.intp) * camera.width + events.x // _BLOCK
    if np.count_nonzero(np.bincount(blocks)) < _FEWEST_BLOCKS:
        return None
    return WindowEvents.prepare(
        events.x.astype(np.float32), events.y.astype(np.float32), s, events.p
    )
