"""Events as arrays, and the causal time windows that a stream of them is cut into.

Every part of the package passes events on in this one representation.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.expected import Expected
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.core.types.options import option
from emoflow_ros.errors import InputError

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class Events:
    """Events of one sensor as columns of equal length N, in order of arrival.

    Attributes:
        x: (N,) uint16, pixel column.
        y: (N,) uint16, pixel row.
        t: (N,) int64, time in nanoseconds.
        p: (N,) bool, polarity (True = ON, brighter).
        stands_for: (N,) uint32, of thinned events how many of the stream each one stands for,
            itself among them; None: each for itself.
    """

    x: NDArray[np.uint16]
    y: NDArray[np.uint16]
    t: NDArray[np.int64]
    p: NDArray[np.bool_]
    stands_for: NDArray[np.uint32] | None = None

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, index: slice | NDArray[np.bool_] | NDArray[np.intp]) -> "Events":
        """Select events by slice (views), mask or indices (copies)."""
        stands_for = None if self.stands_for is None else self.stands_for[index]
        return Events(self.x[index], self.y[index], self.t[index], self.p[index], stands_for)

    @property
    def came(self) -> int:
        """How many events of the stream these stand for: their number, if none were thinned."""
        return len(self) if self.stands_for is None else int(self.stands_for.sum(dtype=np.int64))

    @staticmethod
    def empty() -> "Events":
        """No events."""
        return Events(
            np.empty(0, np.uint16),
            np.empty(0, np.uint16),
            np.empty(0, np.int64),
            np.empty(0, np.bool_),
        )

    @staticmethod
    def concatenate(parts: Sequence["Events"]) -> "Events":
        """Join parts in the order given."""
        if not parts:
            return Events.empty()
        if len(parts) == 1:
            return parts[0]
        stands_for = None
        if any(e.stands_for is not None for e in parts):
            shares = [
                np.ones(len(e), np.uint32) if e.stands_for is None else e.stands_for for e in parts
            ]
            stands_for = np.concatenate(shares)
        return Events(
            np.concatenate([e.x for e in parts]),
            np.concatenate([e.y for e in parts]),
            np.concatenate([e.t for e in parts]),
            np.concatenate([e.p for e in parts]),
            stands_for,
        )

    def inside(self, width: int, height: int) -> NDArray[np.bool_]:
        """Mask (N,) of the events that lie on a sensor of width x height pixels."""
        return (self.x < width) & (self.y < height)


@dataclass(frozen=True, slots=True)
class Window:
    """Events of the interval [t_start, t_end), in nanoseconds.

    In a window by count, events that share the time of the first one left out may lie at t_end.
    `gyro` holds the readings of the interval, and the next one on either side; None where there
    is no gyro. `expected` tells how the scene may move in it; None where that is not known.
    """

    t_start: int
    t_end: int
    events: Events
    gyro: GyroReadings | None = None
    expected: Expected | None = None

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return (self.t_end - self.t_start) / NS_PER_S

    def since(self, t: int) -> "Window":
        """Return the part from time t (ns) on, the window itself if it starts no earlier."""
        if t <= self.t_start:
            return self
        events = self.events[int(np.searchsorted(self.events.t, t)) :]
        return replace(self, t_start=t, events=events)

    def latest(self, count: int) -> "Window":
        """Return the part since the count-th event from the end, the window itself if it has less.

        Args:
            count: at least 1.
        """
        return self if count >= len(self.events) else self.since(int(self.events.t[-count]))

    def until(self, t: int) -> "Window":
        """Return the part before time t (ns)."""
        events = self.events[: int(np.searchsorted(self.events.t, t))]
        return replace(self, t_end=t, events=events)

    def with_gyro(self, readings: GyroReadings) -> "Window":
        """Return the window with those of a gyro's readings that cover it."""
        return replace(self, gyro=readings.covering(self.t_start, self.t_end))


@dataclass(frozen=True)
class WindowPolicy:
    """How a stream is cut into windows: by time, or with count > 0 by events.

    With max_displacement_px > 0 they are the longest that may be: core.lattice.motion_windows
    shortens them.

    Raises:
        InputError: a count_stride above count, which would leave gaps.
    """

    duration_ms: float = option(
        90.0, "length of a window by time", unit="ms", minimum=1.0, maximum=10_000.0
    )
    stride_ms: float = option(
        0.0,
        "from one window's start to the next one's: less than the duration overlaps them; "
        "0, or more than the duration, means the duration",
        unit="ms",
        minimum=0.0,
        maximum=10_000.0,
    )
    count: int = option(
        0, "with count > 0 windows hold this many events, whatever their duration", minimum=0
    )
    count_stride: int = option(
        0, "events from one window's start to the next one's; 0 means count", minimum=0
    )
    max_displacement_px: float = option(
        0.0,
        "estimate of each window only the latest part in which 90 % of the pixels move no further "
        "than this; 0 takes windows whole",
        unit="px",
        minimum=0.0,
        maximum=1000.0,
    )
    min_count: int = option(
        10_000, "events that such a part holds at least, if the window does", minimum=100
    )

    @property
    def duration_ns(self) -> int:
        """Length of a window by time."""
        return round(self.duration_ms * NS_PER_MS)

    @property
    def stride_ns(self) -> int:
        """From one window's start to the next one's, by time."""
        return min(round(self.stride_ms * NS_PER_MS) or self.duration_ns, self.duration_ns)

    def __post_init__(self) -> None:
        if self.count_stride > self.count:
            raise InputError(
                "window.count_stride",
                f"{self.count_stride} with windows of {self.count} events leaves gaps",
                "give a stride of at most window.count",
            )


# The slices that the latest twist is estimated from (core.products.present_motion): their length,
# the events that their latest 10 ms may hold, and the bins in which that is limited
# (core.stream.thinning).
SLICE_MS = 60.0
SLICE_EVENTS = 4_000
SLICE_BIN_NS = 5 * NS_PER_MS


class TimeJumpError(Exception):
    """Event time went backwards within one stream."""

    def __init__(self, last: int, now: int) -> None:
        super().__init__(f"event time went back by {(last - now) / NS_PER_S:.6f} s")
        self.last = last
        self.now = now


class WindowSlicer:
    """Cut a stream of events into windows as soon as each is complete.

    A window by time is complete when an event at or after its end has been seen, so no
    window ever holds or waits for more of the future than that one event. Windows without
    any event are skipped.
    """

    def __init__(self, policy: WindowPolicy) -> None:
        self.policy = policy
        self.reset()

    def reset(self) -> None:
        """Forget everything, for example after a jump in time."""
        self._parts: deque[Events] = deque()
        self._last: int | None = None
        self._start: int | None = None

    @property
    def next_end(self) -> int | None:
        """Time from which on an event completes a window, ns; None where only a push can tell."""
        if self.policy.count or self._start is None:
            return None
        return self._start + self.policy.duration_ns

    def push(self, events: Events) -> list[Window]:
        """Take the next events of the stream and return the windows they complete.

        Raises:
            TimeJumpError: times are not in order, within `events` or against what came
                before. Nothing of `events` is kept then.
        """
        if len(events) == 0:
            return []
        backwards = np.flatnonzero(events.t[1:] < events.t[:-1])
        if len(backwards):
            i = int(backwards[0])
            raise TimeJumpError(int(events.t[i]), int(events.t[i + 1]))
        if self._last is not None and events.t[0] < self._last:
            raise TimeJumpError(self._last, int(events.t[0]))
        self._last = int(events.t[-1])
        if self._start is None:
            self._start = int(events.t[0])
        self._take(events)
        return self._by_count() if self.policy.count else self._by_time()

    def _take(self, events: Events) -> None:
        self._parts.append(events)

    def _by_time(self) -> list[Window]:
        assert self._start is not None and self._last is not None
        duration, stride = self.policy.duration_ns, self.policy.stride_ns
        if self._last < self._start + duration:
            return []
        pending = Events.concatenate(self._parts)
        windows = []
        while self._last >= self._start + duration:
            end = self._start + duration
            first, last = np.searchsorted(pending.t, [self._start, end])
            if last > first:
                windows.append(Window(self._start, end, pending[first:last]))
                self._start += stride
            else:  # jump over silence in whole strides
                self._start += stride * max(1, (int(pending.t[last]) - end) // stride)
        self._parts = deque([pending[int(np.searchsorted(pending.t, self._start)) :]])
        return windows

    def _by_count(self) -> list[Window]:
        count = self.policy.count
        stride = self.policy.count_stride or count
        if sum(map(len, self._parts)) < count + 1:
            return []
        pending = Events.concatenate(self._parts)
        windows = []
        first = 0
        # One event more than `count`, so that the window's end is known.
        while len(pending) - first > count:
            end = max(int(pending.t[first + count]), int(pending.t[first]) + 1)
            windows.append(Window(int(pending.t[first]), end, pending[first : first + count]))
            first += stride
        self._parts = deque([pending[first:]])
        return windows
