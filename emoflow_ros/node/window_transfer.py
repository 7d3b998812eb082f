"""A window as the arrays that cross to the worker: in few bytes, and no more than it has to."""

from typing import Any

import numpy as np

from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.gyro_measurement import GyroReadings
from emoflow_ros.node.tasks import Arrays


def to_arrays(window: Window) -> tuple[dict[str, Any], Arrays]:
    """Return the interval of a window, and the columns of its events and of its gyro.

    Times count from the window's start. Times and counts take the shortest type that holds them
    all: an event of a window of up to 4 s has at most 11 bytes while it stands for less than 65536.
    """
    events = window.events
    arrays = {"x": events.x, "y": events.y, "p": events.p, "t": _short(events.t - window.t_start)}
    if events.stands_for is not None:
        arrays["stands_for"] = _short(events.stands_for)
    if window.gyro is not None:
        arrays |= {"gyro_t": window.gyro.t, "gyro_w": window.gyro.w}
    return {"t_start": window.t_start, "t_end": window.t_end}, arrays


def from_arrays(interval: dict[str, Any], arrays: Arrays) -> Window:
    """Build the window again; it equals the one that `to_arrays` was given."""
    start, end = interval["t_start"], interval["t_end"]
    stands_for = arrays.get("stands_for")
    events = Events(
        arrays["x"],
        arrays["y"],
        arrays["t"].astype(np.int64) + start,
        arrays["p"],
        None if stands_for is None else stands_for.astype(np.uint32),
    )
    gyro = None
    if "gyro_t" in arrays:
        gyro = GyroReadings(arrays["gyro_t"], arrays["gyro_w"])
    return Window(start, end, events, gyro)


def _short(values: np.ndarray[Any, np.dtype[Any]]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return values of 0 and more as the shortest unsigned type that holds them."""
    return values.astype(np.min_scalar_type(int(values.max(initial=0))))
