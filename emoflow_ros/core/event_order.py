"""Events of a stream in order of time: single ones that are too early or too late are left out.

USB hiccups, jitter of a sensor's clock and words that are lost inside a packet give some events a
time that is none of theirs. Time that goes back and goes on from there is another matter: the
sensor's clock, or the recording, has started anew.
"""

import numpy as np
from numba import njit, types

from emoflow_ros.core.events import NS_PER_MS, Events, TimeJumpError

# So many events that stay back for so long, by their own times, are of a time that began anew.
_MANY = 10
FOR_GOOD_NS = 100 * NS_PER_MS
_SHORT_NS = FOR_GOOD_NS // 2
_NEVER = -(1 << 62)

_TIMES = types.Array(types.int64, 1, "C", readonly=True)
_FOUND = types.Tuple((types.int64, types.int64, types.int64, types.int64))


class EventOrder:
    """Passes on the events of a stream, so that their times never decrease.

    An event that is earlier than one before it is left out. Where the events that are later than
    what follows are fewer than that, and of less than 50 ms, these are left out instead.

    Attributes:
        left_out: events so far.
        last: time of the last event that was passed on, ns; None before the first.
        first_disorder: (time before, time behind), ns, of the first step back; None without one.
    """

    def __init__(self) -> None:
        self.left_out = 0
        self.first_disorder: tuple[int, int] | None = None
        self.reset()

    def reset(self) -> None:
        """Forget the times, for example after a jump, but not the counts."""
        self._last, self._run, self._run_first = _NEVER, 0, 0

    @property
    def last(self) -> int | None:
        """Time of the last event that was passed on, ns; None before the first."""
        return None if self._last == _NEVER else self._last

    def __call__(self, events: Events) -> Events:
        """Take the next events of the stream, and return those that are in order.

        Raises:
            TimeJumpError: time went back for good. Nothing of `events` is taken then.
        """
        t = events.t
        if len(t) == 0:
            return events
        if t[0] >= self._last and not (t[1:] < t[:-1]).any():
            self._last, self._run = int(t[-1]), 0
            return events
        self._note(events)
        keep = np.zeros(len(t), np.bool_)
        state = self._last, self._run, self._run_first
        last, run, run_first, jump = _sift(np.ascontiguousarray(t), *state, keep)
        if jump >= 0:
            raise TimeJumpError(last, run_first)
        self._last, self._run, self._run_first = last, run, run_first
        kept = events[keep]
        self.left_out += len(events) - len(kept)
        return kept

    def _note(self, events: Events) -> None:
        if self.first_disorder is None:
            t = np.concatenate([[self._last], events.t])
            i = int(np.argmax(t[1:] < t[:-1]))
            self.first_disorder = int(t[i]), int(t[i + 1])


@njit(
    types.boolean(_TIMES, types.boolean[::1], types.int64, types.int64, types.int64, types.int64),
    cache=True,
    nogil=True,
)
def _are_late(t, keep, start, first, run, base):  # type: ignore[no-untyped-def]
    """Tell whether it is the events before `start` that are wrong, not the `run` that follows.

    Those later than `first`, the first of the run, have to be fewer and of a short time. None of
    them may have come before this array, with `base` as the last.
    """
    ahead, last = 0, first
    for j in range(start - 1, -1, -1):
        if keep[j]:
            if t[j] <= first:
                return True
            ahead += 1
            last = max(last, t[j])
            if ahead >= run or last - t[j] >= _SHORT_NS:
                return False
    return base <= first


@njit(
    _FOUND(_TIMES, types.int64, types.int64, types.int64, types.boolean[::1]),
    cache=True,
    nogil=True,
)
def _sift(t, last, run, run_first, keep):  # type: ignore[no-untyped-def]
    """Mark the events to pass on in `keep` (N,).

    `run` events in a row were earlier than `last`, the first of them at `run_first`.

    Returns:
        `last`, `run` and `run_first` behind these events, and where time went back for good, or -1.
    """
    base = last
    start = 0  # of the run, as far as it lies in this array
    for i in range(len(t) + 1):
        is_end = i == len(t)
        is_back = not is_end and t[i] < last
        if is_back:
            if run == 0:
                run_first, start = t[i], i
            run += 1
        for_good = is_back and run >= _MANY and t[i] - run_first >= FOR_GOOD_NS
        if run > 0 and (not is_back or for_good):
            if _are_late(t, keep, start, run_first, run, base):
                last = base
                for j in range(start):
                    if keep[j]:
                        keep[j] = t[j] <= run_first
                        last = t[j] if keep[j] else last
                for j in range(start, min(i + 1, len(t)) if is_back else i):
                    keep[j] = t[j] >= last
                    last = t[j] if keep[j] else last
                run = 0
            elif for_good:
                return last, run, run_first, i
        if not is_end and not is_back:
            keep[i] = t[i] >= last
            last = t[i] if keep[i] else last
            run = 0
    return last, run, run_first, -1
