"""What is drawn from a flow: point tracks, colour images and images of the warped events."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.stream.thinning import spread
from emoflow_ros.core.types.estimate import FlowSampler
from emoflow_ros.core.types.events import NS_PER_S, Events, Window

# A window's tracks are sampled at its start, its end and 7 times in between.
INSTANTS = 9
_SHOWN = 4  # of these, every fourth one is drawn: lines of half a window look smooth

Points = NDArray[np.float64]
Times = NDArray[np.int64]

Image = NDArray[np.uint8]

# The circle runs through six colours; the number of steps from each to the next.
_CORNERS = (
    ((255, 0, 0), 15),  # red to yellow
    ((255, 255, 0), 6),  # to green
    ((0, 255, 0), 4),  # to cyan
    ((0, 255, 255), 11),  # to blue
    ((0, 0, 255), 13),  # to magenta
    ((255, 0, 255), 6),  # and back to red
)
_UNKNOWN = 0
_TOO_LONG = 0.75  # colours beyond the longest length are darkened

_SLICES = 32  # the events of one are moved alike: an error of 1/64 of the window's motion
_MOST_EVENTS = 60_000
_WHITE = 0.99  # quantile of the pixels with events that is shown white


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


def color_circle() -> NDArray[np.float64]:
    """Build the 55 colours of the circle, (55, 3) RGB in [0, 1].

    They are those of Baker et al., "A Database and Evaluation Methodology for Optical Flow",
    IJCV 2011, spaced by how well people tell them apart.
    """
    parts = []
    for i, (start, steps) in enumerate(_CORNERS):
        end = _CORNERS[(i + 1) % len(_CORNERS)][0]
        ramp = np.arange(steps)[:, None] / steps
        parts.append((1 - ramp) * start + ramp * np.array(end))
    return np.concatenate(parts) / 255


_CIRCLE = color_circle()


def flow_to_rgb(flow: NDArray[np.floating[Any]], longest: float | None = None) -> Image:
    """Colour a flow image: hue is direction, saturation is length.

    Right is red, down is yellow, left is cyan-blue, up is violet; still pixels are white and
    pixels that are not finite black.

    Args:
        flow: (H, W, 2), u right and v down, in any unit.
        longest: the length shown in full colour, in the same unit; by default the 99th
            percentile of this image. Longer vectors are darkened.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    known = np.isfinite(flow).all(axis=-1)
    u, v = (np.where(known, flow[..., i], 0.0).astype(np.float64) for i in (0, 1))
    length = np.hypot(u, v)
    if longest is None:
        longest = float(np.percentile(length[known], 99)) if known.any() else 1.0
    radius = length / max(longest, 1e-12)
    position = (np.arctan2(v, u) / (2 * np.pi)) % 1.0 * len(_CIRCLE)
    low = position.astype(np.intp) % len(_CIRCLE)
    weight = (position - np.floor(position))[..., None]
    hue = (1 - weight) * _CIRCLE[low] + weight * _CIRCLE[(low + 1) % len(_CIRCLE)]
    pale = 1 - np.minimum(radius, 1)[..., None] * (1 - hue)
    rgb = np.where((radius > 1)[..., None], hue * _TOO_LONG, pale)
    rgb[~known] = _UNKNOWN
    return np.asarray(np.rint(rgb * 255), np.uint8)


def color_wheel(size: int = 151) -> Image:
    """Draw the legend: a disc of all directions and lengths up to `longest` on white."""
    axis = np.linspace(-1, 1, size)
    u, v = np.meshgrid(axis, axis)
    rgb = flow_to_rgb(np.stack([u, v], -1), 1.0)
    rgb[np.hypot(u, v) > 1] = 255
    return rgb


def sharpened_events(
    window: Window, flow: FlowSampler, t: int, width: int, height: int
) -> NDArray[np.uint8]:
    """Draw the events where the flow carries them at time t (ns).

    At most 60 000 events of a window are drawn, spread over it, so that the time this takes is
    bounded.

    Returns:
        (height, width), black without events, white at their 99th percentile per pixel.
    """
    thinned = Window(window.t_start, window.t_end, spread(window.events, _MOST_EVENTS))
    counts = warped_counts(thinned, flow, t, width, height)
    white = np.quantile(counts[counts > 0], _WHITE) if counts.any() else 1.0
    return np.rint(np.minimum(counts / white, 1) * 255).astype(np.uint8)


def warped_counts(
    window: Window, flow: FlowSampler, t: int, width: int, height: int
) -> NDArray[np.int64]:
    """Count the events per pixel where the flow carries them at time t (ns), (height, width).

    Each goes to its nearest pixel; those that leave the image are not counted.
    """
    moved = _carried(window.events, window, flow, t)
    moved = np.rint(moved[np.isfinite(moved).all(axis=1)]).astype(np.int64)
    x, y = moved[((moved >= 0) & (moved < (width, height))).all(axis=1)].T
    return np.bincount(y * width + x, minlength=width * height).reshape(height, width)


def _carried(events: Events, window: Window, flow: FlowSampler, t: int) -> NDArray[np.float64]:
    """Move the events (N, 2) along the flow, those of each slice of the window together."""
    points = np.stack([events.x, events.y], axis=1).astype(np.float64)
    # By the length: float64 rounds times since 1970 to 256 ns.
    length = window.t_end - window.t_start
    edges = window.t_start + np.linspace(0, length, _SLICES + 1).astype(np.int64)
    bounds = np.searchsorted(events.t, edges)
    bounds[-1] = len(events)  # of a window by count, which has some at its end
    for i in range(_SLICES):
        mine = slice(bounds[i], bounds[i + 1])
        middle = int(edges[i] + edges[i + 1]) // 2
        if mine.start < mine.stop:
            points[mine] = flow.tracks(points[mine], (middle, t))[1]
    return points
