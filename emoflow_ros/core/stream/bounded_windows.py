"""Windows that hold no more events than an estimator uses, from a stream or one by one.

What they hold together is counted as it came, each event once.
"""

import time
from collections import deque
from dataclasses import replace

import numpy as np

from emoflow_ros.core.stream.thinning import EventBudget
from emoflow_ros.core.types.estimate import Estimate, Estimator
from emoflow_ros.core.types.events import Events, Window, WindowSlicer


class RateLimitedSlicer(WindowSlicer):
    """Cut a stream into windows of a limited rate; what is left out is not kept meanwhile.

    The windows are those of `WindowSlicer`, thinned by `EventBudget.limit_rate`, however the stream
    is cut into messages. Windows by count hold as many events as the policy says and are not
    thinned.

    Args:
        budget: with the window policy.

    Attributes:
        left_out: events that were left out as soon as they came.
    """

    def __init__(self, budget: EventBudget) -> None:
        self.budget = budget
        self.left_out = 0
        super().__init__(budget.policy)

    def reset(self) -> None:
        """Forget everything but the count, for example after a jump in time."""
        super().reset()
        self._done: int | None = None  # bins before this time are thinned, ns

    def push(self, events: Events) -> list[Window]:
        """Take the next events of the stream and return the windows they complete.

        Raises:
            TimeJumpError: as of `WindowSlicer`.
        """
        windows = super().push(events)
        if self.policy.count or not windows:
            return windows
        rest = Events.concatenate(self._parts)
        thinned = int(np.searchsorted(rest.t, self._done or 0))
        self._parts = deque([rest[:thinned], rest[thinned:]])
        return windows

    def _take(self, events: Events) -> None:
        if not self.policy.count:
            assert self._start is not None and self._last is not None
            if self._done is None:
                self._done = self._start
            edge, _ = self.budget.bin_at(self._start, self._last)
            if edge > self._done:
                events = self._thin(events, self._start, self._done, edge)
                self._done = edge
        super()._take(events)

    def _thin(self, events: Events, origin: int, done: int, edge: int) -> Events:
        """Thin what lies in the bins from `done` to `edge`; return the events after them.

        Only the first of these bins has events from before; the others are not copied.
        """
        begun: deque[Events] = deque()
        while self._parts and (not len(self._parts[-1]) or self._parts[-1].t[-1] >= done):
            begun.appendleft(self._parts.pop())
        _, end_of_first = self.budget.bin_at(origin, done)
        first, ended = (int(i) for i in np.searchsorted(events.t, [end_of_first, edge]))
        for part in (Events.concatenate([*begun, events[:first]]), events[first:ended]):
            stay = self.budget.limit_rate(part, origin)
            self.left_out += len(part) - len(stay)
            self._parts.append(stay)
        return events[ended:]


class BoundedWindows:
    """Thins windows before they are estimated, to what the node would send to its worker.

    Args:
        estimator: of the thinned windows.
        budget: how many events they may hold.
    """

    def __init__(self, estimator: Estimator, budget: EventBudget) -> None:
        self._estimator = estimator
        self._budget = budget

    def reset(self) -> None:
        """Forget previous windows: the next one starts cold."""
        self._estimator.reset()

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to what stays of a window, and note the time that it took."""
        began = time.perf_counter()
        found = self._estimator.estimate(self._budget.thin(window))
        quality = replace(found.quality, runtime_s=time.perf_counter() - began)
        return replace(found, quality=quality)


class DistinctEvents:
    """A running count of the events in windows of one stream, in the order of the stream.

    Every window holds all events of the stream from its first to its last one, or thinned ones that
    stand for them. Windows may overlap and may leave gaps; each begins and ends no earlier than the
    one before it.

    Attributes:
        count: events in the windows so far, each once.
    """

    def __init__(self) -> None:
        self.count = 0
        self.start_anew()

    def start_anew(self) -> None:
        """Take the next window for one of another stream; the count goes on."""
        self._end: int | None = None  # of the last window, ns
        self._last = 0  # time of the latest event that is counted, ns
        self._ties = 0  # counted events of that time

    def add(self, window: Window) -> None:
        """Count the events of the next window that no window before it held."""
        t = window.events.t
        if len(t) == 0:
            return
        known = 0
        if self._end is not None and window.t_start < self._end:
            before, through = (int(i) for i in np.searchsorted(t, [self._last, self._last + 1]))
            # Of the events at that time a window by count may have left out the rest.
            known = min(before + self._ties, through)
        else:
            self._ties = 0
        last = int(t[-1])
        if window.events.stands_for is not None:  # by time: thinned or not, all before its end is
            self._last, self._ties = window.t_end, 0  # counted
        elif known < len(t):
            ties = len(t) - max(known, int(np.searchsorted(t, last)))
            self._ties = ties + (self._ties if last == self._last else 0)
            self._last = last
        self.count += window.events[known:].came
        self._end = window.t_end
