"""How many events windows may hold: fewer where the worker is too slow."""

import time
from collections.abc import Callable
from dataclasses import replace

from emoflow_ros.core.stream.thinning import EventBudget

# At 25 million events per second a window with a quarter of its events takes the worker a sixth
# less, and the node half. Fewer save nothing more.
_SMALLEST = 4
_LATE = 2  # windows in a row that find the worker busy
_EASE_S = 3.0
_ENOUGH = 10_000  # events in the latest 10 ms: an estimator needs some of them


class EventShare:
    """Halves the events of windows while these come faster than they are estimated.

    Args:
        clock: monotonic time in s.

    Attributes:
        part: n stands for the n-th part of the usual events: 1, 2 or 4.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.part = 1
        self._clock = clock
        self._late = 0
        self._changed = clock()

    def note(self, *, is_busy: bool) -> bool:
        """Note whether a window finds the worker busy with another one.

        Returns:
            Whether `part` has changed.
        """
        now = self._clock()
        self._late = self._late + 1 if is_busy else 0
        part = self.part
        if self._late:
            self._changed = now if part > 1 else self._changed
            if self._late >= _LATE:
                part, self._late = min(2 * part, _SMALLEST), 0
        elif now - self._changed > _EASE_S:
            part = max(part // 2, 1)
        if part == self.part:
            return False
        self.part, self._changed = part, now
        return True


def share_of(budget: EventBudget, part: int) -> EventBudget:
    """Return the budget of windows that may hold the n-th part of the usual events."""
    enough = min(budget.max_events, _ENOUGH)
    return replace(budget, max_events=max(budget.max_events // part, enough))
