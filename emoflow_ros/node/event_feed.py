"""From the middleware's queue to the decoder: event messages wait in between, but not for long."""

import time
from collections.abc import Callable, Iterable, Iterator

from rclpy.node import Node
from rclpy.subscription import Subscription

from emoflow_ros.node.backlog import Backlog, LeftOut
from emoflow_ros.node.diagnostics import Statistics
from emoflow_ros.node.throttled import throttled

_TURN_S = 0.005  # decoding at a stretch
# The first n-th of each message is decoded: n doubles where more of what may wait does than these
# shares for some time, the first one for n = 1, and is halved again after a longer time.
_FAR, _NEAR = 1 / 2, 1 / 8
_SETTLE_S, _EASE_S = 0.05, 3.0
_SMALLEST_PART = 16


class Pressure:
    """Tells how much of each message can be decoded, from how much waits.

    Args:
        clock: monotonic time in s.

    Attributes:
        part: n stands for the first n-th of each message: 1, 2, 4, 8 or 16.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.part = 1
        self._clock = clock
        self._changed = self._little = clock()
        self._lost: float | None = None

    def note(self, share: float) -> None:
        """Note how much waits, as a share of what may wait; also that nothing waits any more."""
        now = self._clock()
        if share > (_FAR if self.part == 1 else _NEAR):
            if now - max(self._changed, self._little) > _SETTLE_S:
                self._set(min(2 * self.part, _SMALLEST_PART))
            return
        self._little = now
        if self.part > 1 and now - self._changed > _EASE_S:
            self._set(self.part // 2)

    def note_loss(self) -> None:
        """Note that messages were left out: twice in a short time is more than a stall."""
        now = self._clock()
        if self._lost is not None and now - self._lost < _EASE_S:
            self._set(min(2 * self.part, _SMALLEST_PART))
        self._lost = now

    def _set(self, part: int) -> None:
        self.part = part
        self._changed = self._clock()


class EventFeed:
    """Hands the messages of one topic on, for a few milliseconds at a time.

    In between, the executor runs the node's other callbacks, and results are published. If the
    messages come faster than they are taken, only the first part of each is decoded. If that does
    not suffice, those that are too old are left out.

    Args:
        node: wakes the executor, and logs.
        topic: name of the topic.
        fetch: returns the messages that wait in the middleware.
        length_ns: returns how much event time may wait here, ns.
        take: gets each message, and n where only the first n-th of it is to be decoded, else 1.
        end_turn: called after the last message of each turn.
        skip: told when messages before the next one are left out.
        statistics: counts the messages that are left out.
        clock: monotonic time in s.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        *,
        fetch: Callable[[], Iterable[bytes]],
        length_ns: Callable[[], int],
        take: Callable[[bytes, int], None],
        end_turn: Callable[[], None],
        skip: Callable[[LeftOut], None],
        statistics: Statistics,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._node = node
        self._topic = topic
        self._fetch = fetch
        self._length_ns = length_ns
        self._take = take
        self._end_turn = end_turn
        self._skip = skip
        self._statistics = statistics
        self._clock = clock
        self._backlog = Backlog()
        self._pressure = Pressure(clock)
        self._fetched_s = 0.0  # since the last turn
        self._is_open = True
        self._more_waits = node.create_guard_condition(self._go_on)

    def receive(self, data: bytes) -> None:
        """Take a message from the executor, and all that wait behind it in the middleware.

        Each turn of the executor costs as much as some messages.
        """
        has_turn = len(self._backlog) > 0  # _go_on will be called
        if not has_turn:
            self._pressure.note(0.0)
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
        began = self._clock()
        for data in self._fetch():
            self._backlog.add(data)
        self._fetched_s += self._clock() - began

    def _work(self) -> None:
        self._pressure.note(self._backlog.length_ns / self._length_ns())
        self._shorten()
        # Large messages take long to fetch. Little would be decoded if that took most of the time.
        end = self._clock() + max(_TURN_S, self._fetched_s)
        self._fetched_s = 0.0
        while len(self._backlog):
            part = self._pressure.part if self._backlog.is_next_short else 1
            self._statistics.counts["messages_in_part"] += part > 1
            self._take(self._backlog.pop(), part)
            if self._clock() >= end:
                break
        self._end_turn()
        if len(self._backlog):
            self._more_waits.trigger()

    def _shorten(self) -> None:
        left_out = self._backlog.shorten(self._length_ns())
        if left_out is None:
            return
        self._statistics.counts["messages_skipped"] += left_out.count
        self._pressure.note_loss()
        self._skip(left_out)
        self._node.get_logger().warning(
            f"{self._topic}: {left_out.count} messages are left out, because events come faster "
            "than the node decodes them; lower the event rate of the camera or the rate of the "
            "replay, or give the node more of the processor",
            **throttled(),
        )


def fetch_waiting(subscription: Subscription, most: int) -> Iterator[bytes]:
    """Take the serialised messages that wait in the middleware, `most` of them at most."""
    with subscription.handle:
        for _ in range(most):
            found = subscription.handle.take_message(subscription.msg_type, True)
            if found is None:
                return
            yield found[0]
