"""Why the worker has no time for a window: its own work, other processes, or one that hangs."""

from collections import deque

from emoflow_ros.node.tasks import Result

_KEPT = 20  # windows
_STARVED = 0.75  # share of the time that a worker runs which has a core to itself, at least
_BUSY_S = 1.0

# What a window takes hardly depends on its events: a quarter of them saves a fifth.
_SLOW = (
    "the estimation is slower than the events; give a larger window.stride_ms, or a lower "
    "output.twist_rate"
)


class WorkerLoad:
    """Compares the processor time of the last windows with the time that they took.

    At least one thread of a worker runs all the time that it estimates, unless other processes take
    the processor. With a GPU that says nothing.
    """

    def __init__(self) -> None:
        self._work: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def add(self, result: Result) -> None:
        """Note what a window took."""
        self._work.append((result.processor_s, result.wall_s))

    @property
    def share(self) -> float:
        """Processor time over time of the last windows; 1 before the first one."""
        processor_s, wall_s = map(sum, zip(*self._work, strict=True)) if self._work else (0.0, 0.0)
        return processor_s / wall_s if wall_s else 1.0

    def reason(self, busy_s: float, timeout_s: float, *, on_cpu: bool) -> str:
        """Say why windows are dropped while the worker works.

        Args:
            busy_s: for how long it has been busy with a window, s.
            timeout_s: how long it may be.
            on_cpu: whether it estimates on the CPU.
        """
        if hangs := self.hangs(busy_s, timeout_s):
            return hangs
        if on_cpu and self.share < _STARVED:
            return (
                f"other processes leave the estimation {self.share:.0%} of a core; end them, lower "
                "their priority, or give the node cores of its own"
            )
        return _SLOW

    def hangs(self, busy_s: float, timeout_s: float) -> str:
        """Say that the worker has not answered for long; empty if it has."""
        if busy_s < _BUSY_S:
            return ""
        return (
            f"the worker has been busy with one window for {busy_s:.0f} s; it is replaced after "
            f"{timeout_s:g} s (output.timeout_s)"
        )
