"""Small pictures of events."""

import io

import numpy as np
from PIL import Image

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.events import Events

_WIDTH_PX = 112
_INTERVAL_NS = 30_000_000
_ON, _OFF = (31, 95, 168), (176, 58, 46)


def event_picture(events: Events, camera: Camera) -> bytes:
    """Draw the 30 ms in the recording's middle, ON blue and OFF red on white, as PNG."""
    image = np.full((camera.height, camera.width, 3), 255, np.uint8)
    if len(events):
        middle = int(events.t[0] + events.t[-1]) // 2
        first, last = np.searchsorted(events.t, [middle, middle + _INTERVAL_NS])
        some = events[first:last]
        image[some.y[some.p], some.x[some.p]] = _ON
        image[some.y[~some.p], some.x[~some.p]] = _OFF
    height = round(_WIDTH_PX * camera.height / camera.width)
    small = Image.fromarray(image).resize((_WIDTH_PX, height), Image.Resampling.BOX)
    buffer = io.BytesIO()
    small.quantize(64).save(buffer, format="png", optimize=True)
    return buffer.getvalue()
