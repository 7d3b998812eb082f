"""From the middleware's queue to the decoder: event messages wait in between, but not for long."""

import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from emoflow_ros.core.events import NS_PER_MS, NS_PER_S
from emoflow_ros.node.diagnostics import Statistics

if TYPE_CHECKING:  # what cuts windows needs LeftOut, but no ROS
    from rclpy.node import Node
    from rclpy.subscription import Subscription

_TURN_S = 0.005  # decoding at a stretch
_THROTTLE_S = 5.0
# A smaller step back in time is disorder, a larger one starts another run of the recording.
_DISORDER = 100 * NS_PER_MS
# A larger step forward also starts another run: a seek, or a sensor clock that wrapped unseen.
_GAP = 10 * NS_PER_S
# Every type of event message begins with a std_msgs/Header: by the encapsulation of CDR, which says
# the order of bytes, seconds and nanoseconds of its stamp.
_STAMPS = {b"\0\0": struct.Struct(">iI"), b"\0\1": struct.Struct("<iI")}
_STAMP_AT, _STAMP_END = 4, 12
# The stamps do not always tell how much waits. These bounds hold whatever they say.
_MOST_OF_ONE_STAMP = 1000  # messages
_MOST_BYTES = 256 * 2**20


@dataclass(frozen=True)
class LeftOut:
    """Messages that were left out.

    Attributes:
        count: how many.
        jump: step of the stamps among them, or right behind them, that is a jump in time (ns);
            0 where there is none.
    """

    count: int
    jump: int


@dataclass(frozen=True, slots=True)
class _Message:
    data: bytes
    at: int  # event time since the first message, ns, without jumps
    jump: int  # step of the stamps to this message if it is a jump, ns; else 0


class Backlog:
    """Serialised event messages in order of arrival.

    How much event time they cover is told by the stamps of their headers. These are compared with
    one another only, never with a clock of this machine. A message without a stamp takes no time.
    """

    def __init__(self) -> None:
        self._stamp: int | None = None
        self._doubtful: int | None = None
        self._newest = self._taken = 0
        self._begun: int | None = None  # where the run of messages without a gap begins, ns
        self._messages: deque[_Message] = deque()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._messages)

    @property
    def length_ns(self) -> int:
        """Event time from the oldest message to the newest one, ns."""
        return self._messages[-1].at - self._messages[0].at if self._messages else 0

    def add(self, data: bytes) -> None:
        """Append a message."""
        stamp = stamp_of(data)
        step, jump = (0, 0) if stamp is None else self._follow(stamp)
        self._newest += step
        self._messages.append(_Message(data, self._newest, jump))
        self._bytes += len(data)

    def pop(self) -> bytes:
        """Remove the oldest message and return it.

        Raises:
            IndexError: there is none.
        """
        message = self._messages.popleft()
        self._bytes -= len(message.data)
        self._taken = message.at
        if self._begun is None or message.jump:
            self._begun = message.at
        return message.data

    def shorten(self, length_ns: int) -> LeftOut | None:
        """Leave out all messages but the newest if they cover more than this event time.

        Before the next gap at least as much event time is taken, so that there are whole windows
        between two gaps, however slow the node is. If only the excess were left out, a node that
        is too slow would leave out a message for each one that it takes.

        Args:
            length_ns: a window and more, ns.

        Returns:
            What was left out; None if nothing was.
        """
        if len(self._messages) < 2:
            return None
        run = 0 if self._begun is None else self._taken - self._begun
        is_long = self.length_ns > length_ns and run >= length_ns
        is_timeless = self.length_ns == 0 and len(self._messages) > _MOST_OF_ONE_STAMP
        if not (is_long or is_timeless or self._bytes > _MOST_BYTES):
            return None
        newest = self._messages[-1]
        jump = next((message.jump for message in self._messages if message.jump), 0)
        left_out = LeftOut(len(self._messages) - 1, jump)
        self._messages = deque([newest])
        self._bytes = len(newest.data)
        self._begun = None
        return left_out

    def _follow(self, stamp: int) -> tuple[int, int]:
        """Return the step of time to the next stamp and the jump to it, ns; one of them is 0.

        One stamp that is far from those around it is that of a malformed message, and no jump.
        """
        before, doubtful = self._stamp, self._doubtful
        step = 0 if before is None else stamp - before
        if is_jump(step) and (doubtful is None or is_jump(stamp - doubtful)):
            self._doubtful = stamp
            return 0, 0
        self._stamp, self._doubtful = stamp, None
        return (0, step) if is_jump(step) else (step, 0)


class EventFeed:
    """Hands the messages of one topic on, for a few milliseconds at a time.

    In between, the executor runs the node's other callbacks, and results are published. If the
    messages come faster than they are taken, those that are too old are left out.

    Args:
        node: wakes the executor, and logs.
        topic: name of the topic.
        fetch: returns the messages that wait in the middleware.
        length_ns: returns how much event time may wait here, ns.
        take: gets each message.
        skip: told when messages before the next one are left out.
        statistics: counts the messages that are left out.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        node: "Node",
        topic: str,
        *,
        fetch: Callable[[], Iterable[bytes]],
        length_ns: Callable[[], int],
        take: Callable[[bytes], None],
        skip: Callable[[LeftOut], None],
        statistics: Statistics,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._topic = topic
        self._fetch = fetch
        self._length_ns = length_ns
        self._take = take
        self._skip = skip
        self._statistics = statistics
        self._clock = clock
        self._backlog = Backlog()
        self._is_open = True
        self._more_waits = node.create_guard_condition(self._go_on)

    def receive(self, data: bytes) -> None:
        """Take a message from the executor, and all that wait behind it in the middleware.

        Each turn of the executor costs as much as some messages.
        """
        has_turn = len(self._backlog) > 0  # _go_on will be called
        self._backlog.add(data)
        self._add_waiting()
        if not has_turn:
            self._work()

    def close(self) -> None:
        """Forget the messages that wait; hand on no more."""
        self._is_open = False
        self._backlog = Backlog()
        self._node.destroy_guard_condition(self._more_waits)

    def _go_on(self) -> None:
        if self._is_open:
            self._add_waiting()
            self._work()

    def _add_waiting(self) -> None:
        for data in self._fetch():
            self._backlog.add(data)

    def _work(self) -> None:
        self._shorten()
        end = self._clock() + _TURN_S
        while len(self._backlog):
            self._take(self._backlog.pop())
            if self._clock() >= end:
                break
        if len(self._backlog):
            self._more_waits.trigger()

    def _shorten(self) -> None:
        left_out = self._backlog.shorten(self._length_ns())
        if left_out is None:
            return
        self._statistics.counts["messages_skipped"] += left_out.count
        self._skip(left_out)
        self._node.get_logger().warning(
            f"{self._topic}: {left_out.count} messages are left out, because events come faster "
            "than the node decodes them; lower the event rate of the camera or the rate of the "
            "replay, or give the node more of the processor",
            throttle_duration_sec=_THROTTLE_S,
        )


def fetch_waiting(subscription: "Subscription", most: int) -> Iterator[bytes]:
    """Take the serialised messages that wait in the middleware, `most` of them at most."""
    with subscription.handle:
        for _ in range(most):
            found = subscription.handle.take_message(subscription.msg_type, True)
            if found is None:
                return
            yield found[0]


def is_jump(step: int) -> bool:
    """Whether a step of time (ns) from one message to the next starts another run."""
    return not -_DISORDER < step < _GAP


def stamp_of(data: bytes) -> int | None:
    """Return the header's stamp of a message serialised as CDR, ns; None if it has none."""
    stamp = _STAMPS.get(data[:2])
    if stamp is None or len(data) < _STAMP_END:
        return None
    seconds, nanoseconds = stamp.unpack_from(data, _STAMP_AT)
    return int(seconds) * NS_PER_S + int(nanoseconds)
