"""The pictures of a window, drawn in the worker."""

import time
from collections import deque
from collections.abc import Sequence

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import (
    Tracker,
    Tracks,
    flow_to_rgb,
    sharpened_events,
    trails_at_unit_depth,
)
from emoflow_ros.core.types.estimate import Estimate, FlowSampler
from emoflow_ros.core.types.events import Window
from emoflow_ros.node.tasks import Arrays, Picture, Wishes

_TRACKED = 4  # windows: longer tracks tangle where the motion is fast


class Painter:
    """Draws the pictures of one window after another.

    Args:
        camera: whose windows they are.

    Attributes:
        took: how long each picture of the last window took, s.
    """

    def __init__(self, camera: Camera) -> None:
        self.took: dict[str, float] = {}
        self._camera = camera
        self._tracker: Tracker | None = None
        self._recent: deque[Tracks] = deque(maxlen=_TRACKED)

    def draw(self, wishes: Wishes, estimate: Estimate, window: Window) -> Arrays:
        """Draw the pictures that are wanted, of the sensor's size, at the estimate's time.

        Returns:
            Arrays by `Picture`: the flow (height, width, 2) in px/s, NaN = none, with a
            flow_stride of n only its pixels (n * row, n * column); its colours
            (height, width, 3); the sharpened events (height, width); the point tracks up to
            the window's end as line segments (S, 2, 4), see `trails_at_unit_depth`.
        """
        self.took = {}
        if estimate.flow is None:
            return {}
        pictures: Arrays = {}
        began, t, flow = time.monotonic(), estimate.t, estimate.flow
        velocity = np.empty((0, 0, 2), np.float32)
        if {Picture.FLOW, Picture.COLOR} & set(wishes.pictures):  # the first of them pays for it
            velocity = np.asarray(flow.velocity(t), np.float32)
        for name in wishes.pictures:
            match Picture(name):
                case Picture.FLOW:
                    pictures[name] = velocity[:: wishes.flow_stride, :: wishes.flow_stride]
                case Picture.COLOR:
                    pictures[name] = flow_to_rgb(velocity, wishes.flow_color_max or None)
                case Picture.EVENTS:
                    size = self._camera.width, self._camera.height
                    pictures[name] = sharpened_events(window, flow, t, *size)
                case Picture.TRACKS:
                    tracks = self._follow(flow, window, wishes.tracks)
                    pictures[name] = trails_at_unit_depth(tracks, self._camera)
            before, began = began, time.monotonic()
            self.took[name] = began - before
        return pictures

    def _follow(self, flow: FlowSampler, window: Window, count: int) -> Sequence[Tracks]:
        """Carry the points through the window; return the last windows' tracks."""
        if self._tracker is None:
            size = (self._camera.width, self._camera.height)
            self._tracker = Tracker(count, *size, longest=_TRACKED)
        self._recent.append(self._tracker.follow(flow, window.t_start, window.t_end))
        return self._recent
