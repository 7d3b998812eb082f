"""Point tracks: points carried along the estimated flow, from window to window."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import FlowSampler

# A window's tracks are sampled at its start, its end and 7 times in between.
INSTANTS = 9
_SHOWN = 2  # every second instant: lines of a quarter of a window look smooth

Points = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class Tracks:
    """The tracks of P points through one window.

    Attributes:
        times: (INSTANTS,) ns, from the window's start to its end.
        positions: (INSTANTS, P, 2) px; NaN from where a point leaves the image on, and
            everywhere in a window without a flow.
        ids: (P,) number of each point's track, from 0; -1 without a flow.
    """

    times: Times
    positions: Points
    ids: NDArray[np.int64]


def spread_points(count: int, width: int, height: int) -> Points:
    """Spread points evenly over an image, (count, 2) px, in rows that are nearly a grid."""
    rows = max(1, min(count, round(np.sqrt(count * height / width))))
    lengths = np.diff(np.rint(np.linspace(0, count, rows + 1)).astype(int))
    parts = []
    for row, length in enumerate(lengths):
        x = (np.arange(length) + 0.5) * width / length - 0.5
        y = np.full(length, (row + 0.5) * height / rows - 0.5)
        parts.append(np.stack([x, y], axis=-1))
    return np.concatenate(parts)


class Tracker:
    """Carry points through windows.

    A point is carried on from one window to the next while the windows join or overlap. When
    it has left the image, and after a gap or a window without a flow, a new track begins at
    the point's first position.

    Args:
        count: number of points, spread over the image.
        width, height: of the image in pixels.

    Attributes:
        first: (count, 2) px, where tracks begin.
    """

    def __init__(self, count: int, width: int, height: int) -> None:
        self.first = spread_points(count, width, height)
        self._limit = width - 1, height - 1
        self._ids = np.full(count, -1)
        self._next_id = 0
        self._last: Tracks | None = None

    def follow(self, flow: FlowSampler | None, t_start: int, t_end: int) -> Tracks:
        """Carry the points through the next window, from t_start to t_end (ns)."""
        times = t_start + np.linspace(0, t_end - t_start, INSTANTS).astype(np.int64)
        if flow is None:
            self._last = None
            nothing = np.full((INSTANTS, *self.first.shape), np.nan)
            return Tracks(times, nothing, np.full_like(self._ids, -1))
        start = self._begin(t_start)
        positions = self._within(flow.tracks(start, times.tolist()))
        self._last = Tracks(times, positions, self._ids.copy())
        return self._last

    def _begin(self, t: int) -> Points:
        """Positions at a window's start; begin new tracks where they ended."""
        last = self._last
        if last is not None and last.times[0] <= t <= last.times[-1]:
            start = interpolate(last.times, last.positions, t)
        else:
            start = np.full_like(self.first, np.nan)
        new = ~np.isfinite(start).all(axis=-1)
        count = int(new.sum())
        self._ids[new] = self._next_id + np.arange(count)
        self._next_id += count
        return np.where(new[:, None], self.first, start)

    def _within(self, positions: Points) -> Points:
        """Cut tracks off where they leave the image."""
        outside = ~((positions >= 0) & (positions <= self._limit)).all(axis=-1)
        gone = np.logical_or.accumulate(outside, axis=0)
        return np.where(gone[..., None], np.nan, positions)


def interpolate(times: Times, path: Points, t: int) -> Points:
    """Interpolate a path (len(times), P, 2) linearly at time t within its times, (P, 2)."""
    k = int(np.searchsorted(times, t))
    if t == times[k]:
        return path[k]
    share = (t - times[k - 1]) / (times[k] - times[k - 1])
    return np.asarray(path[k - 1] + share * (path[k] - path[k - 1]))


def lines_at_unit_depth(tracks: Tracks, camera: Camera) -> NDArray[np.float32]:
    """Draw tracks as lines in front of the camera.

    Returns:
        Start and end of S line segments on the plane z = 1 of the optical frame, (S, 2, 3).
    """
    bearings, _ = camera.undistort(tracks.positions[::_SHOWN])
    ends = np.stack([bearings[:-1], bearings[1:]], axis=-2).reshape(-1, 2, 2)
    ends = ends[np.isfinite(ends).all(axis=(1, 2))]
    return np.concatenate([ends, np.ones((len(ends), 2, 1))], axis=-1).astype(np.float32)
