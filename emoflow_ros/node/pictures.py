"""What can be seen of a window: which pictures there are, and how the worker draws them."""

from collections import deque
from collections.abc import Sequence
from enum import StrEnum

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate, FlowSampler
from emoflow_ros.core.flow_color import flow_to_rgb
from emoflow_ros.core.sharpened import sharpened_events
from emoflow_ros.core.tracks import Tracker, Tracks, trails_at_unit_depth
from emoflow_ros.core.windows import Window
from emoflow_ros.node.channel import Arrays
from emoflow_ros.node.tasks import Wishes

_TRACKED = 4  # windows: longer tracks tangle where the motion is fast


class Picture(StrEnum):
    """A picture, by its topic."""

    FLOW = "flow/image"
    COLOR = "flow/color"
    EVENTS = "flow/iwe"
    TRACKS = "flow/tracks"


ENCODINGS = {Picture.FLOW: "32FC2", Picture.COLOR: "rgb8", Picture.EVENTS: "mono8"}


class Painter:
    """Draws the pictures of one window after another.

    Args:
        camera: whose windows they are.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._tracker: Tracker | None = None
        self._recent: deque[Tracks] = deque(maxlen=_TRACKED)

    def draw(self, wishes: Wishes, estimate: Estimate, window: Window) -> Arrays:
        """Draw the pictures that are wanted, of the sensor's size, at the estimate's time.

        Returns:
            Arrays by `Picture`: the flow (height, width, 2) in px/s, NaN = none, or of it the
            pixels (n * row, n * column) for a flow_stride of n; its colours
            (height, width, 3); the sharpened events (height, width); the point tracks up to
            the window's end as line segments (S, 2, 4), see `trails_at_unit_depth`.
        """
        flow = estimate.flow
        if flow is None:
            return {}
        pictures: Arrays = {}
        if {Picture.FLOW, Picture.COLOR} & set(wishes.pictures):
            pictures[Picture.FLOW] = np.asarray(flow.velocity(estimate.t), np.float32)
        if Picture.COLOR in wishes.pictures:
            longest = wishes.flow_color_max or None
            pictures[Picture.COLOR] = flow_to_rgb(pictures[Picture.FLOW], longest)
        if Picture.FLOW in wishes.pictures:
            stride = wishes.flow_stride
            pictures[Picture.FLOW] = pictures[Picture.FLOW][::stride, ::stride]
        if Picture.EVENTS in wishes.pictures:
            size = (self._camera.width, self._camera.height)
            pictures[Picture.EVENTS] = sharpened_events(window, flow, estimate.t, *size)
        if Picture.TRACKS in wishes.pictures:
            tracks = self._follow(flow, window, wishes.tracks)
            pictures[Picture.TRACKS] = trails_at_unit_depth(tracks, self._camera)
        return {name: pictures[name] for name in wishes.pictures}

    def _follow(self, flow: FlowSampler, window: Window, count: int) -> Sequence[Tracks]:
        """Carry the points through the window; return the last windows' tracks."""
        if self._tracker is None:
            size = (self._camera.width, self._camera.height)
            self._tracker = Tracker(count, *size, longest=_TRACKED)
        self._recent.append(self._tracker.follow(flow, window.t_start, window.t_end))
        return self._recent
