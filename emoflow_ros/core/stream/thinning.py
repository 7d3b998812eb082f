"""Thinning: how many events a window may hold, and which of them stay where more come.

Where more events come than an estimator uses, the others cost time and memory and say nothing. What
stays is spread over time, image and polarity as the stream is.
"""

from bisect import bisect_right
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.stream import thinning_kernels
from emoflow_ros.core.types.events import NS_PER_MS, Events, Window, WindowPolicy

_BIN_NS = NS_PER_MS  # longest bin; within it, the order of time is not kept even
# Fast motion takes parts of a window that are shorter than the rest. Those down to this length hold
# max_events events, where so many come.
_SHORTEST_NS = 10 * NS_PER_MS
_GROWTH = 1.5  # of the ages between which a window is equally dense


@dataclass(frozen=True)
class EventBudget:
    """How many events a stream may have per time, and a window as a whole.

    An estimator takes max_events of a window's latest part, as long as the motion allows. So
    the latest 10 ms of a window may hold max_events, and what is older fewer per time, so that
    every longer part, and the whole window, holds max_events as well.

    The rate of a stream is limited in bins of time. All edges of windows are edges of bins, so that
    a stream and the windows cut from it lose the same events.

    Args:
        policy: how windows are cut.
        max_events: that an estimator takes of a window.
        bin_ns: longest bin, ns.
    """

    policy: WindowPolicy
    max_events: int
    bin_ns: int = _BIN_NS

    def thin(self, window: Window) -> Window:
        """Return a window with what stays of its events.

        The rate is limited in windows of the policy's duration: others are not cut from a stream by
        time, and may hold all they have in a short time.
        """
        if window.t_end - window.t_start == self.policy.duration_ns:
            window = replace(window, events=self.limit_rate(window.events, window.t_start))
        return self.bound(window)

    def limit_rate(self, events: Events, origin: int) -> Events:
        """Return what stays of a stream's events: `events` itself if no bin holds too many.

        Args:
            events: all events of the bins that they lie in.
            origin: the start of any window of the stream, ns.
        """
        if not len(events):
            return events
        edges = self._edges(origin, int(events.t[0]), int(events.t[-1]))
        shortest = min(_SHORTEST_NS, self.policy.duration_ns)
        limits = np.maximum(self.max_events * np.diff(edges) // shortest, 1)
        return _thin_pieces(events, np.searchsorted(events.t, edges), limits)

    def bin_at(self, origin: int, t: int) -> tuple[int, int]:
        """Return start and end of the bin that holds time t, ns; `origin` as in `limit_rate`."""
        stride, offsets = self.policy.stride_ns, self._offsets
        strides, within = divmod(t - origin, stride)
        begin = origin + strides * stride
        next_one = bisect_right(offsets, within)
        return begin + offsets[next_one - 1], begin + offsets[next_one]

    def bound(self, window: Window) -> Window:
        """Return a window of at most `capacity` events, those of the latest 10 ms before others."""
        ages, limits = self._ages(window.t_end - window.t_start)
        if len(window.events) <= limits.sum():
            return window
        bounds = np.searchsorted(window.events.t, window.t_end - ages[::-1])
        bounds[-1] = len(window.events)  # of a window by count, which has some at its end
        return replace(window, events=_thin_pieces(window.events, bounds, limits[::-1]))

    @property
    def capacity(self) -> int:
        """Events of a window of the policy's duration at most, once it is thinned."""
        return int(self._ages(self.policy.duration_ns)[1].sum())

    @cached_property
    def _offsets(self) -> list[int]:
        """Edges of the bins in a stride, from its start to its end, ns: windows end at some."""
        stride = self.policy.stride_ns
        corners = sorted({0, self.policy.duration_ns % stride, stride})
        edges = [0]
        for a, b in pairwise(corners):
            count = -(-(b - a) // self.bin_ns)
            edges += [a + k * (b - a) // count for k in range(1, count + 1)]
        return edges

    def _edges(self, origin: int, first: int, last: int) -> NDArray[np.int64]:
        """Edges (M + 1,) of the M bins that hold the times from first to last, ns."""
        bounds = self.bin_at(origin, first)
        if last < bounds[1]:
            return np.array(bounds)
        stride = self.policy.stride_ns
        strides = np.arange((first - origin) // stride, (last - origin) // stride + 2)
        edges = (origin + strides[:, None] * stride + self._offsets[:-1]).ravel()
        begin, end = np.searchsorted(edges, [first, last], side="right")
        return edges[begin - 1 : end + 1]

    def _ages(self, length: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Say how many of a window's events may be how old at its end.

        Windows that overlap share the edges at whole strides, so that what they count adds up.

        Returns:
            Edges (M + 1,) of the ages, ns, the youngest first; the limits (M,) between them.
        """
        edges = {0, length, *range(0, length, self.policy.stride_ns)}
        age = shortest = min(_SHORTEST_NS, length)
        while age < length:
            edges.add(age)
            age = int(_GROWTH * age)
        ages = np.array(sorted(edges))
        limits = self.max_events * np.diff(ages) // np.maximum(ages[:-1], shortest)
        return ages, np.maximum(limits, 1)


def spread(events: Events, count: int) -> Events:
    """Return at most `count` events, spread over time as those of the stream are."""
    if events.stands_for is None and len(events) <= count:
        return events
    return events[spread_places(events, count)]


def spread_places(events: Events, count: int) -> NDArray[np.intp]:
    """Return the indices (M,) of the events that `spread` takes.

    Events of a thinned stream are taken where the stream has them: a step of the stream that none
    but one stands for gives that one.
    """
    if events.stands_for is None:
        count = min(count, len(events))
        return np.arange(count) * len(events) // max(1, count)
    chosen = np.empty(count, np.intp)
    return chosen[: thinning_kernels.steps(np.ascontiguousarray(events.stands_for), chosen)]


def first_of_latest(events: Events, count: int) -> int:
    """Index of the first of the latest events that stand for at most `count` of the stream.

    0 if all are no more, the number of events if the last one alone stands for more.
    """
    if events.stands_for is None:
        return max(0, len(events) - count)
    return thinning_kernels.first_of_latest(np.ascontiguousarray(events.stands_for), count)


def _thin_pieces(events: Events, bounds: NDArray[np.intp], limits: NDArray[np.int64]) -> Events:
    """Thin the pieces between bounds (M + 1,) that hold more than their limits (M,).

    What stays of such a piece is every n-th event of each block of the image, ON and OFF apart.
    Each stands for as many events as the others do. Events that stand for many are at most taken
    once, so that there may be fewer.
    """
    if (np.diff(bounds) <= limits).all():
        return events
    one_each = events.stands_for is None
    weights = np.ones(1, np.uint32) if events.stands_for is None else events.stands_for
    stay = int(np.minimum(np.diff(bounds), limits).sum())
    chosen, shares = np.empty(stay + 1, np.intp), np.empty(stay, np.uint32)
    whole = np.ascontiguousarray
    number = thinning_kernels.thin(
        whole(events.x), whole(events.y), whole(events.t), whole(events.p), whole(weights),
        whole(bounds), whole(limits), one_each, chosen, shares,
    )  # fmt: skip
    return replace(events[chosen[:number]], stands_for=shares[:number])
