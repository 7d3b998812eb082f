"""What every reader checks of its events: their order of time, and that they lie on the sensor."""

from pathlib import Path

from emoflow_ros.core.event_order import EventOrder
from emoflow_ros.core.events import NS_PER_S, Events, TimeJumpError
from emoflow_ros.errors import InputError

# A few events outside are a sensor's glitch; more than this share tells of another sensor.
MAX_OUTSIDE_SHARE = 0.01
_MIN_JUDGED = 1000
# Of the events that are earlier than ones before them: a larger share is no hiccup.
MAX_UNORDERED_SHARE = 0.25
_MANY = 1_000_000


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
        self.seen = 0
        self.outside = 0

    def __call__(self, events: Events, dropped: int = 0) -> Events:
        """Return the chunk without the events outside the sensor, and those not in order of time.

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
        try:
            return self.order(events)
        except TimeJumpError as jump:
            raise InputError(
                self._path,
                f"event time goes back for good ({jump.now / NS_PER_S:.6f} s follows "
                f"{jump.last / NS_PER_S:.6f} s): the sensor's clock or the recording starts anew",
                "give each part as a recording of its own",
            ) from None

    def finish(self) -> None:
        """Check the stream as a whole, at its end.

        Raises:
            InputError: no events at all, or too many outside or not in order.
        """
        if self.seen == 0:
            raise InputError(self._path, "holds no events", "give a recording that has some")
        self._judge_outside()
        self._judge_order()

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
