"""Where to enter a file whose events are in order of time, but for single ones."""

from bisect import bisect_left
from collections.abc import Callable


def first_since(begin: int, end: int, time: Callable[[int], int], since: int) -> int:
    """Find the first position of a file at or after a time, by bisection.

    An event that is too early can send the bisection past it. The positions before the one that is
    found show that: 1, 2, 4, 8 and so on of them back. Events that are too late lead to an earlier
    position, from which nothing is missed.

    Args:
        begin, end: the positions, for example rows or bytes, from the first to behind the last one.
        time: the time at or behind a position, ns.
        since: the time, ns.

    Returns:
        The position; `end` where all are before that time.
    """
    while True:
        found = bisect_left(range(begin, end), since, key=time) + begin
        back = (found - (1 << k) for k in range((found - begin).bit_length()))
        missed = next((at for at in back if at >= begin and time(at) >= since), None)
        if missed is None:
            return found
        end = missed
