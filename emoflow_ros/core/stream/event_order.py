"""Events of a stream in order of time: those that are too early or too late are left out.

USB hiccups, jitter of a sensor's clock and words that are lost inside a packet give some events a
time that is none of theirs. Time that goes back and goes on from there is another matter: the
sensor's clock, or the recording, has started anew.
"""

import numpy as np
from numba import types
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.core.types.events import NS_PER_MS, Events, TimeJumpError

# So many events behind one another that are not in order, for so long by their own times, are of a
# time that has started anew. Those of a hiccup do not go on like this, or end sooner.
_MANY = 10
FOR_GOOD_NS = 100 * NS_PER_MS
_STEP_NS = FOR_GOOD_NS // 2  # a larger step of time ends what belongs together
_NEVER = -(1 << 62)

_TIMES = types.Array(types.int64, 1, "C", readonly=True)


class EventOrder:
    """Passes on the events of a stream, so that their times never decrease.

    Of the events given at once as many as possible are passed on; the others are left out. Of two
    that do not fit together it is the earlier time that is left out, and always an event that is
    earlier than one passed on before.

    Attributes:
        left_out: events so far.
        gaps: (K,) int64 ns, of the K events that the last call has left out: when, by the time
            of the event passed on before each.
        first_disorder: (time before, time behind), ns, of the first step back; None without one.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self.gaps: NDArray[np.int64] = np.empty(0, np.int64)
        self.first_disorder: tuple[int, int] | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the times, for example after a jump, but not the counts."""
        self._last = _NEVER
        self._run = np.array([0, 0, 0], np.int64)  # left out: how many, time of first and last

    @property
    def last(self) -> int | None:
        """Time of the last event that was passed on, ns; None before the first."""
        return None if self._last == _NEVER else self._last

    def __call__(self, events: Events) -> Events:
        """Take the next events of the stream, and return those that are in order.

        Raises:
            TimeJumpError: time went back for good. Nothing of `events` is taken then.
        """
        t = np.ascontiguousarray(events.t)
        self.gaps = self.gaps[:0]
        if len(t) == 0:
            return events
        run = self._run.copy()
        keep = self._sift(t, run)
        self._run = run
        if keep is None:
            self._last = int(t[-1])
            return events
        self._note(t)
        before = np.maximum.accumulate(np.where(keep, t, self._last))
        self.gaps = before[~keep]
        self._last = int(before[-1])
        self.left_out += len(self.gaps)
        return events[keep]

    def step_to(self, events: Events) -> int:
        """Step of time from the last event to those that may come next, ns; 0 where one is missing.

        It leads to their first one, or to the middle one in time where the first does not follow.
        """
        t = events.t
        if self._last == _NEVER or len(t) == 0:
            return 0
        step = int(t[0]) - self._last
        if 0 <= step < _STEP_NS:
            return step
        middle = (len(t) - 1) // 2
        return int(np.partition(t, middle)[middle]) - self._last

    def settled(self, t: NDArray[np.int64]) -> int:
        """Find how many of the next times (N,) ns no later event can show to be too late.

        That is all but those of the last 50 ms that would be passed on.

        Raises:
            TimeJumpError: time went back for good.
        """
        t = np.ascontiguousarray(t)
        keep = self._sift(t, self._run.copy())
        kept = np.arange(len(t)) if keep is None else np.flatnonzero(keep)
        if len(kept) == 0:
            return 0
        late = int(np.searchsorted(t[kept], t[kept[-1]] - _STEP_NS, side="right"))
        return int(kept[min(late, len(kept) - 1)])

    def _sift(self, t: NDArray[np.int64], run: NDArray[np.int64]) -> NDArray[np.bool_] | None:
        """Mark (N,) the times to pass on, None for all of them; bring `run` up to date.

        Raises:
            TimeJumpError: time went back for good.
        """
        if t[0] >= self._last and not (t[1:] < t[:-1]).any():
            run[:] = 0
            return None
        keep: NDArray[np.bool_] = _longest_order(t) & (t >= self._last)
        if _goes_on(t, keep, run):
            raise TimeJumpError(*self._step_back(t))
        return keep

    def _step_back(self, t: NDArray[np.int64]) -> tuple[int, int]:
        """Times (before, behind), ns, of the step by which time went back."""
        if self._run[0]:  # before these events
            return self._last, int(self._run[1])
        t = np.concatenate([[self._last], t])
        i = int(np.argmax(t[:-1] - t[1:]))
        return int(t[i]), int(t[i + 1])

    def _note(self, t: NDArray[np.int64]) -> None:
        if self.first_disorder is None:
            t = np.concatenate([[self._last], t])
            i = int(np.argmax(t[1:] < t[:-1]))
            self.first_disorder = int(t[i]), int(t[i + 1])


def sifted(order: EventOrder, events: Events) -> tuple[Events, int]:
    """Take the next events of a stream of which none can be waited for.

    Returns:
        Those that are in order, and the step of time (ns) where it went back for good, or where all
        of them are too early; else 0.
    """
    try:
        kept = order(events)
    except TimeJumpError as jump:
        return Events.empty(), jump.now - jump.last
    if len(kept) or not len(events) or order.last is None:
        return kept, 0
    return kept, int(events.t[-1]) - order.last


@njit(types.boolean[::1](_TIMES), nogil=True)
def _longest_order(t):  # type: ignore[no-untyped-def]
    """Mark (N,) the most times t (N,) that never decrease.

    From the end on, `begins` has the event that a run of each length may begin with at the latest.
    """
    begins = np.empty(len(t), np.int64)
    following = np.empty(len(t), np.int64)
    length = 0
    for i in range(len(t) - 1, -1, -1):
        low, high = 0, length
        if length > 0 and t[begins[length - 1]] >= t[i]:
            low = length
        while low < high:
            middle = (low + high) // 2
            if t[begins[middle]] >= t[i]:
                low = middle + 1
            else:
                high = middle
        following[i] = begins[low - 1] if low > 0 else -1
        begins[low] = i
        length = max(length, low + 1)
    keep = np.zeros(len(t), np.bool_)
    i = begins[length - 1] if length > 0 else -1
    while i >= 0:
        keep[i] = True
        i = following[i]
    return keep


@njit(
    types.boolean(_TIMES, types.Array(types.boolean, 1, "C"), types.int64[::1]),
    nogil=True,
)
def _goes_on(t, keep, run):  # type: ignore[no-untyped-def]
    """Tell whether time goes on among the events that are not kept, as after a new start.

    `run` (3,) has the number of those behind one another up to here, and the times of the first and
    the last one, ns; it is brought up to date.
    """
    for i in range(len(t)):
        if keep[i]:
            run[0] = 0
            continue
        if run[0] == 0 or abs(t[i] - run[2]) >= _STEP_NS:
            run[0], run[1] = 0, t[i]
        run[0] += 1
        run[2] = t[i]
        if run[0] >= _MANY and t[i] - run[1] >= FOR_GOOD_NS:
            return True
    return False
