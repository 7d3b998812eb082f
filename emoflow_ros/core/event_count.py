"""How many events windows hold together."""

import numpy as np

from emoflow_ros.core.events import Window


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
