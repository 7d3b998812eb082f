"""The pictures of a window: which there are, and how the worker draws them."""

from enum import StrEnum

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.flow_color import flow_to_rgb
from emoflow_ros.core.sharpened import sharpened_events
from emoflow_ros.core.windows import Window
from emoflow_ros.node.channel import Arrays
from emoflow_ros.node.tasks import Wishes


class Picture(StrEnum):
    """A picture, by its topic."""

    FLOW = "flow/image"
    COLOR = "flow/color"
    EVENTS = "flow/iwe"


ENCODINGS = {Picture.FLOW: "32FC2", Picture.COLOR: "rgb8", Picture.EVENTS: "mono8"}


def draw(wishes: Wishes, estimate: Estimate, window: Window, camera: Camera) -> Arrays:
    """Draw the pictures that are wanted, of the sensor's size, at the estimate's time.

    Returns:
        Arrays by `Picture`: the flow (height, width, 2) in px/s, NaN = none; its colours
        (height, width, 3); the sharpened events (height, width).
    """
    flow = estimate.flow
    if flow is None:
        return {}
    pictures: Arrays = {}
    if {Picture.FLOW, Picture.COLOR} & set(wishes.pictures):
        pictures[Picture.FLOW] = np.asarray(flow.velocity(estimate.t), np.float32)
    if Picture.COLOR in wishes.pictures:
        pictures[Picture.COLOR] = flow_to_rgb(pictures[Picture.FLOW], wishes.flow_color_max or None)
    if Picture.EVENTS in wishes.pictures:
        size = (camera.width, camera.height)
        pictures[Picture.EVENTS] = sharpened_events(window, flow, estimate.t, *size)
    return {name: pictures[name] for name in wishes.pictures}
