"""What comes in and what goes out, and why nothing does: events, windows, twists."""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping

from emoflow_ros.core.types.estimate import Status
from emoflow_ros.node.reports import Level

# Why messages may hold no event that can be used.
REFUSALS = {
    "malformed_messages": "malformed messages: check the driver's message version",
    "wrong_size_messages": "messages of another sensor size: give this sensor's calibration",
    "unordered_messages": "messages in which event time jumps: check the driver",
    "events_unordered": "events out of order: check the driver",
    "events_outside": "events outside the calibration's image: give this sensor's calibration",
}
DROPPED, FAILED, HELD_BACK = "dropped", "failed", "held_back"

# Of windows that give no twist.
_WITHOUT_TWIST = {
    Status.TOO_FEW_EVENTS: "hold too few events: the camera is at rest, or estimator.min_events is "
    "too high for its windows",
    Status.NO_MOTION: "show no motion: the camera is at rest, or the image moves too little for "
    "windows of this length",
    Status.DIVERGED: "diverged: check the calibration, or give longer windows",
    Status.LOST: "are lost, half a second after the last measurement ({detail}): show the camera "
    "more texture or motion",
    DROPPED: "were dropped: {detail}",
    FAILED: "failed: {detail}",
    HELD_BACK: "are less sure than output.max_angular_sd: raise it, or 0 holds none back",
}
_NO_WINDOW = "no window is complete: window.count or window.duration_ms is too large for the events"
_FLOWING_S = 1.0  # events further apart do not flow


class StreamWatch:
    """Watches the node's stream of events, and that of its twists.

    Times count from when the node began to listen, or from the first message that is meant.

    Args:
        counts: of messages that cannot be used, by the names in REFUSALS.
        clock: monotonic time in s.
    """

    def __init__(self, counts: Mapping[str, int], clock: Callable[[], float]) -> None:
        self._counts = counts
        self._clock = clock
        self.listen()

    def listen(self) -> None:
        """Begin anew: nothing was heard on a topic yet."""
        self._last_message = self._clock()
        self._last_event = self._last_twist = -math.inf
        self._flows_since = 0.0
        self._useless_since: float | None = None
        self._begin_to_refuse()
        self._causes: Counter[str] = Counter()  # of windows without a twist, since the last one
        self._details: dict[str, str] = {}

    def take(self, events: int) -> None:
        """Note a message with so many events that can be used."""
        now = self._last_message = self._clock()
        if not events:
            self._useless_since = now if self._useless_since is None else self._useless_since
            return
        if now - self._last_event > _FLOWING_S:
            self._flows_since = now
        self._last_event = now
        self._useless_since = None
        self._begin_to_refuse()

    def give(self) -> None:
        """Note that a twist is published."""
        self._last_twist = self._clock()
        self._causes.clear()

    def miss(self, cause: str, detail: str = "") -> None:
        """Note a window that gives no twist: a Status or one of the words above, and its reason."""
        self._causes[cause] += 1
        self._details[cause] = detail

    def silence(self, silence_s: float) -> Iterator[tuple[Level, str]]:
        """Say why there were no events to use for longer than this, s."""
        now = self._clock()
        if now - self._last_message > silence_s:
            silent = now - self._last_message
            yield Level.WARN, f"no events for {silent:.1f} s: check the driver or the bag"
            return
        if self._useless_since is None or now - self._useless_since <= silence_s:
            return
        useless = f"{now - self._useless_since:.1f} s"
        refused = Counter({name: self._counts[name] - self._before[name] for name in REFUSALS})
        [(name, count)] = refused.most_common(1)
        if count:
            yield Level.ERROR, f"nothing to use for {useless}: {count} {REFUSALS[name]}"
        else:
            yield Level.WARN, f"messages without events for {useless}: check the camera"

    @property
    def pause_s(self) -> float:
        """How long events have paused, s; 0 while they flow, and before the first one."""
        pause = self._clock() - self._last_event
        return pause if _FLOWING_S < pause < math.inf else 0.0

    def missing_twists(self, twist_s: float) -> Iterator[tuple[Level, str]]:
        """Say why no twist was published for longer than this, s, while events came."""
        now = self._clock()
        missing = now - max(self._last_twist, self._flows_since)
        if now - self._last_event > _FLOWING_S or missing <= twist_s:
            return
        reason = _NO_WINDOW
        if self._causes:
            [(cause, count)] = self._causes.most_common(1)
            words = _WITHOUT_TWIST[cause].format(detail=self._details[cause])
            reason = f"{count} of {self._causes.total()} windows {words}"
        yield Level.WARN, f"no twist for {missing:.1f} s: {reason}"

    def _begin_to_refuse(self) -> None:
        self._before = {name: self._counts[name] for name in REFUSALS}
