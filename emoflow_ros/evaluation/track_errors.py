"""Errors of point tracks; the tracks are those of `core.products.pictures`."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.products.pictures import Points, Tracker, Tracks, interpolate
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S
from emoflow_ros.truth import FlowSource, Truth

_RECENT = 6  # windows whose tracks are kept for pictures


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
class ComparedTracks(Tracks):
    """The tracks of P points through one window, and the truth.

    Attributes:
        true_ends: (2, P, 2) px, where the points of these tracks truly are at the window's
            start and end; NaN where unknown.
        errors: of the ends; None where no truth is known.
    """

    true_ends: Points
    errors: TrackErrors | None


class TrackComparer:
    """Carry points through the windows of a recording, and their true positions beside them.

    Args:
        count: number of points, spread over the image.
        camera: of the recording.

    Attributes:
        recent: the last windows' tracks without a gap between them, newest last.
    """

    def __init__(self, count: int, camera: Camera) -> None:
        self._tracker = Tracker(count, camera.width, camera.height)
        self._begun = np.zeros(count, np.int64)
        self.recent: deque[ComparedTracks] = deque(maxlen=_RECENT)

    def follow(self, estimate: Estimate, truth: Truth) -> ComparedTracks:
        """Carry the points through the next window."""
        found = self._tracker.follow(estimate.flow, estimate.t_start, estimate.t_end)
        if estimate.flow is None:
            self.recent.clear()
            unknown = np.full_like(found.positions[:2], np.nan)
            return ComparedTracks(found.times, found.positions, found.ids, unknown, None)
        true_start = self._true_start(found)
        true_end = _truly_carried(true_start, truth.flows, estimate.t_start, estimate.t_end)
        errors = self._errors(found.positions[-1], true_end, estimate.t_end)
        ends = np.stack([true_start, true_end])
        tracks = ComparedTracks(found.times, found.positions, found.ids, ends, errors)
        self.recent.append(tracks)
        return tracks

    def _true_start(self, found: Tracks) -> Points:
        """Where the points truly are at a window's start; a new track begins where its point is."""
        start, t = found.positions[0], int(found.times[0])
        carried = np.isin(found.ids, self.recent[-1].ids if self.recent else [])
        if carried.any():
            last = self.recent[-1]
            true = interpolate(last.times[[0, -1]], last.true_ends, t)
            start = np.where(carried[:, None], true, start)
        else:
            self.recent.clear()
        self._begun[~carried] = t
        return start

    def _errors(self, end: Points, true_end: Points, t_end: int) -> TrackErrors | None:
        known = np.isfinite(end).all(axis=-1) & np.isfinite(true_end).all(axis=-1)
        if not known.any():
            return None
        return TrackErrors(
            end_px=float(np.linalg.norm((end - true_end)[known], axis=-1).mean()),
            true_px=float(np.linalg.norm((true_end - self._tracker.first)[known], axis=-1).mean()),
            age_s=float((t_end - self._begun[known]).mean() / NS_PER_S),
            points=int(known.sum()),
        )


def _truly_carried(points: Points, flows: FlowSource | None, t0: int, t1: int) -> Points:
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
