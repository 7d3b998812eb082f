"""How the stream is cut into slices: by motion, so that each shows edges that moved some pixels."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.front_end.settings import FrontEndSettings
from emoflow_ros.core.front_end.slices import SliceEvents
from emoflow_ros.core.stream.thinning import spread_places
from emoflow_ros.core.types.events import NS_PER_S, Events

F32 = NDArray[np.float32]


def slices(
    events: Events, since: int, until: int, flow: F32, sensor_px: F32, most: int,
    settings: FrontEndSettings,
) -> Iterator[SliceEvents]:  # fmt: skip
    """Cut what is new of the stream into slices of about the same way.

    A slow scene's slice is longer than its part of the new events: it takes earlier ones, too.

    Args:
        events: sorted by time, from before `since` on.
        since: end of the last slice, ns.
        until: end of the new events, ns.
        flow: (rows, columns, 2) px/s of the tracking image.
        sensor_px: (2,) sensor pixels per pixel of the tracking image.
        most: slices.
        settings: of the front end.
    """
    speed = float(np.quantile(np.linalg.norm(flow, axis=-1), settings.slice_share))
    length = min(settings.slice_px / max(speed, 1.0), settings.longest_slice_s)
    new = (until - since) / NS_PER_S
    count = min(most, max(1, math.ceil(new / length)))
    if count > 1:
        length = min(new / count, settings.longest_slice_s)
    for k in range(count):
        end = since + (until - since) * (k + 1) // count
        begin = end - round(length * NS_PER_S)
        first, last = (int(i) for i in np.searchsorted(events.t, [begin, end]))
        if first < last and begin >= int(events.t[0]) - round(0.5 * length * NS_PER_S):
            yield _slice(events[first:last], (begin + end) // 2, sensor_px, settings)


def _slice(events: Events, t: int, sensor_px: F32, settings: FrontEndSettings) -> SliceEvents:
    if len(events) > settings.most_events:
        events = events[spread_places(events, settings.most_events)]
    return SliceEvents(
        t,
        events.x.astype(np.float32) / sensor_px[0],
        events.y.astype(np.float32) / sensor_px[1],
        ((t - events.t) / NS_PER_S).astype(np.float32),
        np.where(events.p, np.float32(1), np.float32(-1)),
    )
