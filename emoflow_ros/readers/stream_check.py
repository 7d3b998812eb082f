"""What every reader checks of its events: their order of time, and that they lie on the sensor."""

from pathlib import Path

from emoflow_ros.core.event_order import EventOrder
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Events, TimeJumpError
from emoflow_ros.errors import InputError

# A few events outside are a sensor's glitch; more than this share tells of another sensor.
MAX_OUTSIDE_SHARE = 0.01
_MIN_JUDGED = 1000
# Of the events that are earlier than ones before them: a larger share is no hiccup.
MAX_UNORDERED_SHARE = 0.25
_MANY = 1_000_000
# Events that are looked at together: only what follows shows that some were too late.
_BLOCK = 100_000
_BLOCK_NS = 200 * NS_PER_MS


class StreamCheck:
    """Check chunk after chunk of a stream: order of time, and events outside the sensor.

    Args:
        path: what to name in errors.
        width, height: the sensor in px.

    Attributes:
        order: has left out the events that are not in order of time, and counts them.
        seen: events so far, those left out among them.
        outside: of them outside the sensor.
    """

    def __init__(self, path: Path, width: int, height: int) -> None:
        self._path = path
        self._width = width
        self._height = height
        self.order = EventOrder()
        self._waiting: list[Events] = []
        self.seen = 0
        self.outside = 0

    def __call__(self, events: Events, dropped: int = 0) -> Events:
        """Take a chunk; return the events that are settled, on the sensor and in order of time.

        The last ones wait for those of the next chunk, or for `finish`.

        Args:
            events: the next chunk.
            dropped: events outside the sensor that the decoder has already left out.

        Raises:
            InputError: time goes back for good, or too many events are outside or not in order.
        """
        inside = events.inside(self._width, self._height)
        if not inside.all():
            dropped += int((~inside).sum())
            events = events[inside]
        self.seen += len(events) + dropped
        self.outside += dropped
        if self.seen >= _MIN_JUDGED:
            self._judge_outside()
        if self.seen >= _MANY:
            self._judge_order()
        if len(events):
            self._waiting.append(events)
        return self._ordered(is_end=False)

    def finish(self) -> Events:
        """Check the stream as a whole, at its end; return the events that have waited.

        Raises:
            InputError: no events at all, or too many outside or not in order.
        """
        rest = self._ordered(is_end=True)
        if self.seen == 0:
            raise InputError(self._path, "holds no events", "give a recording that has some")
        self._judge_outside()
        self._judge_order()
        return rest

    def _ordered(self, *, is_end: bool) -> Events:
        """Sift what waits, up to the events that may prove to be too late."""
        parts = self._waiting
        count = sum(map(len, parts))
        is_long = count >= _BLOCK or (count > 0 and _middle(parts[-1], parts[0]) >= _BLOCK_NS)
        if not (is_long or is_end):
            return self.order(Events.empty())
        events = Events.concatenate(parts)
        try:
            settled = count if is_end or not count else self.order.settled(events.t)
            self._waiting = [events[settled:]] if settled < count else []
            return self.order(events[:settled])
        except TimeJumpError as jump:
            raise InputError(
                self._path,
                f"event time goes back for good ({jump.now / NS_PER_S:.6f} s follows "
                f"{jump.last / NS_PER_S:.6f} s): the sensor's clock or the recording starts anew",
                "give each part as a recording of its own",
            ) from None

    def _judge_outside(self) -> None:
        if self.outside > MAX_OUTSIDE_SHARE * self.seen:
            raise InputError(
                self._path,
                f"{self.outside} of {self.seen} events lie outside the "
                f"{self._width}x{self._height} sensor",
                "give the calibration of the sensor that recorded it",
            )

    def _judge_order(self) -> None:
        if self.order.left_out <= MAX_UNORDERED_SHARE * self.seen:
            return
        assert self.order.first_disorder is not None
        before, after = self.order.first_disorder
        raise InputError(
            self._path,
            f"event times are not sorted ({after / NS_PER_S:.6f} s follows "
            f"{before / NS_PER_S:.6f} s, and {self.order.left_out} of {self.seen} events are "
            "earlier than ones before them)",
            "sort the events by time",
        )


def _middle(late: Events, early: Events) -> int:
    """Time between two chunks, ns, by their middle events: the others may be out of order."""
    return abs(int(late.t[len(late) // 2]) - int(early.t[len(early) // 2]))
