"""The pace of a replay: when each message is due, also after the process was stopped."""

import time
from collections.abc import Callable

_STOPPED_S = 0.5  # no single message takes that long


class Pace:
    """Waits for the time of one message after another.

    A stop of the process between two messages (Ctrl-Z, SIGSTOP) delays all that follow: they
    are not sent in a burst, which no subscriber could take.

    Args:
        rate: 2 is twice as fast as it was recorded.
        clock, sleep: monotonic time in s, and a wait of so many s.

    Attributes:
        lag_s: the latest that a message ever was, stops left out.
    """

    def __init__(
        self,
        rate: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.lag_s = 0.0
        self._rate = rate
        self._clock = clock
        self._sleep = sleep
        self._started = clock()
        self._late = 0.0

    def wait(self, recorded_s: float) -> None:
        """Wait until the message of so many seconds into the recording is due."""
        due = self._started + recorded_s / self._rate
        if (ahead := due - self._clock()) > 0:
            self._sleep(ahead)
        late = max(0.0, self._clock() - due)
        if late - self._late > _STOPPED_S:
            self._started += late - self._late
            late = self._late
        self._late = late
        self.lag_s = max(self.lag_s, late)
