"""Point tracks: points carried along the estimated flow, from window to window."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.windows import NS_PER_S
from emoflow_ros.offline.truth import FlowSource, Truth

# A window's tracks are sampled at its start, its end and 7 times in between.
INSTANTS = 9
_RECENT = 6  # windows whose tracks are kept for pictures

Points = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class TrackErrors:
    """How far the tracks are from the truth at a window's end.

    Attributes:
        end_px: mean distance from where the points truly are, px.
        true_px: mean length of the true displacement since the tracks began, px.
        age_s: mean time since they began, s.
        points: how many tracks have a truth.
    """

    end_px: float
    true_px: float
    age_s: float
    points: int


@dataclass(frozen=True)
class Tracks:
    """The tracks of P points through one window.

    Attributes:
        times: (INSTANTS,) ns, from the window's start to its end.
        positions: (INSTANTS, P, 2) px; NaN from where a point leaves the image on, and
            everywhere in a window without a flow.
        ids: (P,) number of each point's track in the recording, from 0; -1 without a flow.
        true_ends: (2, P, 2) px, where the points of these tracks truly are at the window's
            start and end; NaN where unknown.
        errors: of the ends; None where no truth is known.
    """

    times: Times
    positions: Points
    ids: NDArray[np.int64]
    true_ends: Points
    errors: TrackErrors | None


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
    """Carry points through the windows of a recording.

    A point is carried on from one window to the next while the windows join or overlap. When
    it has left the image, and after a gap or a window without a flow, a new track begins at
    the point's first position.

    Args:
        count: number of points, spread over the image.
        camera: of the recording.

    Attributes:
        recent: the last windows' tracks, newest last.
    """

    def __init__(self, count: int, camera: Camera) -> None:
        self._limit = camera.width - 1, camera.height - 1
        self._first = spread_points(count, camera.width, camera.height)
        self._ids = np.full(count, -1)
        self._begun = np.zeros(count, np.int64)
        self._next_id = 0
        self.recent: deque[Tracks] = deque(maxlen=_RECENT)

    def follow(self, estimate: Estimate, truth: Truth) -> Tracks:
        """Carry the points through the next window, and their true positions beside them."""
        steps = np.linspace(0, estimate.t_end - estimate.t_start, INSTANTS).astype(np.int64)
        times = estimate.t_start + steps
        if estimate.flow is None:
            self.recent.clear()
            nothing = np.full((INSTANTS, *self._first.shape), np.nan)
            return Tracks(times, nothing, np.full_like(self._ids, -1), nothing[:2], None)
        start, true_start = self._begin(estimate.t_start)
        positions = self._within(estimate.flow.tracks(start, times.tolist()))
        true_end = _carry(true_start, truth.flows, estimate.t_start, estimate.t_end)
        errors = self._errors(positions[-1], true_end, estimate.t_end)
        ends = np.stack([true_start, true_end])
        tracks = Tracks(times, positions, self._ids.copy(), ends, errors)
        self.recent.append(tracks)
        return tracks

    def _begin(self, t: int) -> tuple[Points, Points]:
        """Positions and true positions at a window's start; begin new tracks where they ended."""
        last = self.recent[-1] if self.recent else None
        if last is not None and last.times[0] <= t <= last.times[-1]:
            start = _at(last.times, last.positions, t)
            true = _at(last.times[[0, -1]], last.true_ends, t)
        else:
            self.recent.clear()
            start = true = np.full_like(self._first, np.nan)
        new = ~np.isfinite(start).all(axis=-1)
        count = int(new.sum())
        self._ids[new] = self._next_id + np.arange(count)
        self._next_id += count
        self._begun[new] = t
        return np.where(new[:, None], self._first, start), np.where(new[:, None], self._first, true)

    def _within(self, positions: Points) -> Points:
        """Cut tracks off where they leave the image."""
        outside = ~((positions >= 0) & (positions <= self._limit)).all(axis=-1)
        gone = np.logical_or.accumulate(outside, axis=0)
        return np.where(gone[..., None], np.nan, positions)

    def _errors(self, end: Points, true_end: Points, t_end: int) -> TrackErrors | None:
        known = np.isfinite(end).all(axis=-1) & np.isfinite(true_end).all(axis=-1)
        if not known.any():
            return None
        return TrackErrors(
            end_px=float(np.linalg.norm((end - true_end)[known], axis=-1).mean()),
            true_px=float(np.linalg.norm((true_end - self._first)[known], axis=-1).mean()),
            age_s=float((t_end - self._begun[known]).mean() / NS_PER_S),
            points=int(known.sum()),
        )


def _at(times: Times, path: Points, t: int) -> Points:
    """Interpolate a path (len(times), P, 2) linearly at time t, (P, 2)."""
    k = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
    if t == times[k + 1]:
        return path[k + 1]
    share = (t - times[k]) / (times[k + 1] - times[k])
    return np.asarray(path[k] + share * (path[k + 1] - path[k]))


def _carry(points: Points, flows: FlowSource | None, t0: int, t1: int) -> Points:
    """Move points (P, 2) by the true flow of their nearest pixels; NaN where it is unknown."""
    flow = flows.displacement(t0, t1) if flows else None
    if flow is None:
        return np.full_like(points, np.nan)
    height, width = flow.valid.shape
    at = np.rint(np.nan_to_num(points, nan=-1.0)).astype(np.intp)
    inside = ((at >= 0) & (at < (width, height))).all(axis=-1)
    x, y = np.where(inside[:, None], at, 0).T
    known = inside & flow.valid[y, x]
    return np.where(known[:, None], points + flow.displacement[y, x], np.nan)
