"""Slicers: they cut a stream of events into windows for given intervals.

A window holds the events of its interval, earlier ones too, or a fixed number of events.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from emoflow_ros.core.types.events import Events, Window

Interval = tuple[int, int]  # start, end in ns


class Slicer(Protocol):
    """Cuts a stream of events into windows, as core.types.events.WindowSlicer does."""

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        ...


@runtime_checkable
class EndingSlicer(Slicer, Protocol):
    """A slicer that has windows left when the stream ends."""

    def finish(self) -> list[Window]:
        """Return the windows that would wait for events after the last ones."""
        ...


@dataclass(frozen=True, slots=True)
class Clip(Window):
    """A window whose estimate is compared over an interval inside it.

    Attributes:
        compared: the interval with all of its events, of which the window may hold more or fewer.
    """

    compared: Window = field(kw_only=True)

    def since(self, t: int) -> Window:
        """Return the part from time t (ns) on, at the least the interval that is compared."""
        return Window.since(self, min(t, self.compared.t_start))


def compared_part(window: Window) -> Window:
    """Return the interval that a window's estimate is compared over, with its events."""
    return window.compared if isinstance(window, Clip) else window


class IntervalSlicer:
    """Cut windows at given intervals, which start in order and may overlap.

    An interval is complete when an event at or after its end has been seen. Intervals without
    any event are left out.
    """

    def __init__(self, intervals: Sequence[Interval]) -> None:
        self._intervals = deque(intervals)
        self._pending = Events.empty()

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        self._pending = Events.concatenate([self._pending, events])
        windows = []
        while self._intervals and len(self._pending):
            start, end = self._intervals[0]
            if self._pending.t[-1] < end:
                break
            self._intervals.popleft()
            first, last = np.searchsorted(self._pending.t, [start, end])
            if last > first:
                windows.append(Window(start, end, self._pending[first:last]))
        self._pending = _without_past(self._pending, self._intervals, 0)
        return windows


class CausalSlicer:
    """Cut windows that end with given intervals and last at least `shortest` ns.

    A shorter interval gets events from before it, as far back as the stream goes; none come from
    after it. Intervals start in order and end at different times; those without any event are
    left out.
    """

    def __init__(self, intervals: Sequence[Interval], shortest: int) -> None:
        self._starts = {end: start for start, end in intervals}
        self._windows = IntervalSlicer([(min(a, b - shortest), b) for a, b in intervals])
        self._first: int | None = None

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        if self._first is None and len(events):
            self._first = int(events.t[0])
        clips = [self._clip(window) for window in self._windows.push(events)]
        return [clip for clip in clips if len(clip.compared.events)]

    def _clip(self, window: Window) -> Clip:
        assert self._first is not None
        start = self._starts[window.t_end]
        window = window.since(min(start, self._first))
        return Clip(window.t_start, window.t_end, window.events, compared=window.since(start))


class ClipSlicer:
    """Cut clips of `count` events around given intervals, as the published code does.

    Where an interval holds fewer events, half of those that are missing come from before it and
    half from after it, that is from the future; where it holds more, its last `count` are taken.
    The window spans the interval and the events. Intervals without any event are left out.
    """

    def __init__(self, intervals: Sequence[Interval], count: int) -> None:
        self._intervals = deque(intervals)
        self._count = count
        self._pending = Events.empty()

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the clips they complete."""
        self._pending = Events.concatenate([self._pending, events])
        return self._cut(ended=False)

    def finish(self) -> list[Window]:
        """Return the clips of complete intervals that lack events from after the stream's end."""
        return self._cut(ended=True)

    def _cut(self, *, ended: bool) -> list[Window]:
        clips: list[Window] = []
        pending = self._pending
        while self._intervals and len(pending):
            start, end = self._intervals[0]
            first, last = (int(i) for i in np.searchsorted(pending.t, [start, end]))
            half = max(0, self._count - (last - first)) // 2
            if pending.t[-1] < end or (len(pending) < last + half and not ended):
                break
            self._intervals.popleft()
            if last > first:
                begin = max(0, first - half) if half else max(first, last - self._count)
                clips.append(_clip(start, end, pending[first:last], pending[begin : last + half]))
        self._pending = _without_past(pending, self._intervals, self._count // 2)
        return clips


class CroppedSlicer:
    """Leave the events from row `rows` on out of another slicer's windows."""

    def __init__(self, slicer: Slicer, rows: int) -> None:
        self._slicer = slicer
        self._rows = rows

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        return [self._crop(window) for window in self._slicer.push(events)]

    def finish(self) -> list[Window]:
        """Return the windows that are left at the end of the stream."""
        if not isinstance(self._slicer, EndingSlicer):
            return []
        return [self._crop(window) for window in self._slicer.finish()]

    def _crop(self, window: Window) -> Window:
        above = window.events[window.events.y < self._rows]
        if isinstance(window, Clip):
            return replace(window, events=above, compared=self._crop(window.compared))
        return replace(window, events=above)


def with_lead_in(intervals: Sequence[Interval], count: int) -> list[Interval]:
    """Put up to `count` intervals of the same length into the gap before an interval."""
    result: list[Interval] = []
    last_end: int | None = None
    for start, end in intervals:
        length = end - start
        room = count if last_end is None else min(count, (start - last_end) // length)
        result += [(start - k * length, start - (k - 1) * length) for k in range(room, 0, -1)]
        result.append((start, end))
        last_end = end
    return result


def _clip(start: int, end: int, inside: Events, events: Events) -> Clip:
    t_start = min(start, int(events.t[0]))
    t_end = max(end, int(events.t[-1]) + 1)
    return Clip(t_start, t_end, events, compared=Window(start, end, inside))


def _without_past(events: Events, intervals: Sequence[Interval], margin: int) -> Events:
    """Keep what the next interval needs: its events and `margin` events before it."""
    if not intervals:
        return Events.empty()
    return events[max(0, int(np.searchsorted(events.t, intervals[0][0])) - margin) :]
