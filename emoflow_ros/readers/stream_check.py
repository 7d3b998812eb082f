"""What every reader checks of its events: their order of time, and that they lie on the sensor."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from emoflow_ros.core.stream.event_order import EventOrder
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, TimeJumpError
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


class SettledOrder:
    """Passes on events in order of time, once no later one can show that they are too late.

    Attributes:
        sift: leaves out the events that are not in order, and counts them.
    """

    def __init__(self) -> None:
        self.sift = EventOrder()
        self._waiting: list[Events] = []

    def __call__(self, events: Events) -> Events:
        """Take the next events; return those that are settled.

        Raises:
            TimeJumpError: time went back for good. All wait; see `restart`.
        """
        if len(events):
            self._waiting.append(events)
        parts = self._waiting
        count = sum(map(len, parts))
        if count < _BLOCK and (count == 0 or _apart(parts[0], parts[-1]) < _BLOCK_NS):
            return self.sift(Events.empty())
        waiting = self._joined()
        settled = self.sift.settled(waiting.t)
        found = self.sift(waiting[:settled])
        self._waiting = [waiting[settled:]]
        return found

    def finish(self) -> Events:
        """Return the events that still wait.

        Raises:
            TimeJumpError: as above.
        """
        found = self.sift(self._joined())
        self._waiting = []
        return found

    def restart(self, jump: TimeJumpError) -> Events:
        """Go on behind a jump; return the events before it that waited."""
        waiting = self._joined()
        t = waiting.t
        steps = np.flatnonzero((t[:-1] == jump.last) & (t[1:] == jump.now)) + 1
        at = int(steps[0]) if len(steps) else 0
        before = Events.empty()
        with suppress(TimeJumpError):  # of several: what lies between them is left out
            before = self.sift(waiting[:at])
        self.sift.reset()
        self._waiting = [waiting[at:]]
        return before

    def _joined(self) -> Events:
        self._waiting = [Events.concatenate(self._waiting)]
        return self._waiting[0]


def _apart(early: Events, late: Events) -> int:
    """Time between two chunks, ns, by their middle events: the others may be out of order."""
    return abs(int(late.t[len(late) // 2]) - int(early.t[len(early) // 2]))


class StreamCheck:
    """Check chunk after chunk of a stream: order of time, and events outside the sensor.

    Args:
        path: what to name in errors.
        width, height: the sensor in px.

    Attributes:
        order: leaves out the events that are not in order of time, and counts them.
        seen: events so far, those left out among them.
        outside: of them outside the sensor.
    """

    def __init__(self, path: Path, width: int, height: int) -> None:
        self._path = path
        self._width = width
        self._height = height
        self._settled = SettledOrder()
        self.order = self._settled.sift
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
        with self._jump_refused():
            return self._settled(events)

    def finish(self) -> Events:
        """Check the stream as a whole, at its end; return the events that have waited.

        Raises:
            InputError: no events at all, or too many outside or not in order.
        """
        with self._jump_refused():
            rest = self._settled.finish()
        if self.seen == 0:
            raise InputError(self._path, "holds no events", "give a recording that has some")
        self._judge_outside()
        self._judge_order()
        return rest

    @contextmanager
    def _jump_refused(self) -> Generator[None]:
        try:
            yield
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
