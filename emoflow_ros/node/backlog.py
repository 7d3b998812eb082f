"""Event messages that wait to be decoded: how much event time they cover, and what is left out."""

import struct
from collections import deque
from dataclasses import dataclass

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S

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
# The first parts of longer messages may look like light that flickers at 100 to 120 Hz.
_LONGEST_IN_PART = 6 * NS_PER_MS


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
    step: int  # event time since the message before it, ns


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
        self._messages.append(_Message(data, self._newest, jump, step))
        self._bytes += len(data)

    @property
    def is_next_short(self) -> bool:
        """Whether the stamps show that the oldest message covers at most 6 ms."""
        return 0 < self._messages[0].step <= _LONGEST_IN_PART

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
