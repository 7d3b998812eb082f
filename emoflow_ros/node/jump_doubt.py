"""One wrong stamp is no jump in time: a message whose stamp jumps waits for the next one."""

from collections.abc import Callable
from dataclasses import dataclass

from emoflow_ros.node.backlog import is_jump, stamp_of


@dataclass(frozen=True, slots=True)
class Believed:
    """A message, and what is believed of its stamp.

    Attributes:
        data: the serialised message.
        part: n for its first n-th.
        jump: step of time before it that starts another run, ns; 0 if there is none.
        is_stamp_right: whether those around it confirm its stamp.
    """

    data: bytes
    part: int
    jump: int = 0
    is_stamp_right: bool = True


class JumpDoubt:
    """Confirms each jump of the stamps by the message behind it, or refutes it."""

    def __init__(self) -> None:
        self._doubtful: tuple[int, bytes, int] | None = None  # stamp, message, part

    def judge(
        self, data: bytes, part: int, last: int | None, is_readable: Callable[[bytes], bool]
    ) -> list[Believed]:
        """Take a message; return those to go on with, in order.

        Args:
            data, part: the message.
            last: the last stamp that was believed, ns; None before the first one.
            is_readable: tells whether a message is one at all; else it is returned at once.
        """
        stamp = stamp_of(data)
        if stamp is None or last is None:
            return [*self._refuted(), Believed(data, part)]
        doubtful = self._doubtful
        if not is_jump(stamp - last):
            return [*self._refuted(), Believed(data, part)]
        if doubtful is None or is_jump(stamp - doubtful[0]):
            refuted = self._refuted()
            if not is_readable(data):
                return [*refuted, Believed(data, part, is_stamp_right=False)]
            self._doubtful = stamp, data, part
            return refuted
        self._doubtful = None
        first, its_data, its_part = doubtful
        return [Believed(its_data, its_part, jump=first - last), Believed(data, part)]

    def forget(self) -> bool:
        """Forget the message that waits, and tell whether there was one."""
        was_there, self._doubtful = self._doubtful is not None, None
        return was_there

    def _refuted(self) -> list[Believed]:
        if self._doubtful is None:
            return []
        _, data, part = self._doubtful
        self._doubtful = None
        return [Believed(data, part, is_stamp_right=False)]
