"""Point tracks: points carried along the estimated flow, from window to window."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import FlowSampler
from emoflow_ros.core.windows import NS_PER_S

# A window's tracks are sampled at its start, its end and 7 times in between.
INSTANTS = 9
_SHOWN = 4  # of these, every fourth one is drawn: lines of half a window look smooth

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
        longest: windows after which a point begins a new track, not all of them at once, so
            that they stay spread over the image; None for no end.

    Attributes:
        first: (count, 2) px, where tracks begin.
    """

    def __init__(self, count: int, width: int, height: int, longest: int | None = None) -> None:
        self.first = spread_points(count, width, height)
        self._limit = width - 1, height - 1
        self._longest = longest
        self._phase = np.random.default_rng(0).permutation(count)
        self._windows = 0
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
        if self._longest is not None:
            new |= (self._phase + self._windows) % self._longest == 0
        self._windows += 1
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


def trails(windows: Sequence[Tracks]) -> tuple[Points, Points]:
    """Join the tracks of windows, oldest first, that reach the last one's end.

    Where windows overlap, the later one's positions count.

    Returns:
        Start and end of S line segments (S, 2, 2) px, and their ages (S, 2) in s before the
        last window's end.
    """
    last = windows[-1]
    segments, ages = [], []
    for tracks, following in zip(windows, [*windows[1:], None], strict=True):
        until = last.times[-1] if following is None else following.times[0]
        instants = int(np.searchsorted(tracks.times, until)) + 1
        positions = tracks.positions[:instants, tracks.ids == last.ids]
        age = (last.times[-1] - tracks.times[:instants]) / NS_PER_S
        steps = np.stack([positions[:-1], positions[1:]], axis=2)
        segments.append(steps.reshape(-1, 2, 2))
        ages.append(np.repeat(np.stack([age[:-1], age[1:]], axis=-1), steps.shape[1], axis=0))
    paths, when = np.concatenate(segments), np.concatenate(ages)
    known = np.isfinite(paths).all(axis=(1, 2))
    return paths[known], when[known]


def trails_at_unit_depth(windows: Sequence[Tracks], camera: Camera) -> NDArray[np.float32]:
    """Draw the trails of windows, oldest first, as lines in front of the camera.

    Returns:
        Start and end of S line segments, (S, 2, 4): their place on the plane z = 1 of the
        optical frame, and their freshness, from 0 at the first window's start to 1 at the last
        one's end.
    """
    coarse = [Tracks(w.times[::_SHOWN], w.positions[::_SHOWN], w.ids) for w in windows]
    segments, ages = trails(coarse)
    bearings, _ = camera.undistort(segments)
    fresh = 1 - ages * NS_PER_S / (windows[-1].times[-1] - windows[0].times[0])
    lines = np.concatenate([bearings, np.ones_like(bearings[..., :1]), fresh[..., None]], axis=-1)
    return lines[np.isfinite(lines).all(axis=(1, 2))].astype(np.float32)
