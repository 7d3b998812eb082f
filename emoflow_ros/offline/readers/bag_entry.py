"""Where to enter a bag, which is ordered by log time, to read from an event time on."""

from collections.abc import Callable

from emoflow_ros.core.windows import NS_PER_S

_SLACK_S = (1, 10, 100)  # log times follow event times at about a constant distance


def log_time_before(
    since: int, first_event: Callable[[int | None], tuple[int, int] | None]
) -> int | None:
    """Find a log time from which on no event at or after an event time is missed.

    Event times are in order, so that a first event before `since` proves that it is early enough.

    Args:
        since: the event time, ns.
        first_event: log and event time, ns, of the first event logged at or after a time (None:
            of all).

    Returns:
        The log time in ns; None for the bag's beginning.
    """
    first = first_event(None)
    if first is None:
        return None
    logged, time = first
    for slack_s in _SLACK_S:
        start = since + logged - time - slack_s * NS_PER_S
        if start <= logged:
            return None
        found = first_event(start)
        if found is not None and found[1] < since:
            return start
    return None
