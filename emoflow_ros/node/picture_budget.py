"""Which pictures are drawn with a window: those that do not make the next windows wait."""

import time
from collections.abc import Callable, Mapping, Sequence

from emoflow_ros.node.tasks import Result

_CHEAP = 0.1  # of the time that the estimate leaves until the next window
_WAITED_S = 0.005  # a window that waited longer came while the worker was busy
_SMOOTHING = 0.2


class PictureBudget:
    """Chooses pictures by what the last ones took, so that they are dropped before windows are.

    Cheap ones are always drawn. Others are drawn one after another, as far as there is time until
    the next window, but at least one where the window did not wait; so all have their turn.

    Args:
        clock: monotonic time in s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._costs: dict[str, float] = {}
        self._drawn: dict[str, float] = {}
        self._runtime_s = 0.0

    def choose(self, wished: Sequence[str], received: float, interval_s: float) -> tuple[str, ...]:
        """Choose for the window that is estimated now.

        Args:
            wished: the pictures that somebody subscribes to.
            received: monotonic time at which the window was complete, s.
            interval_s: from one window to the next, s.
        """
        left = max(0.0, interval_s - self._runtime_s)
        cheap = {name for name in wished if self._costs.get(name, 0.0) <= _CHEAP * left}
        has_waited = self._clock() - received > _WAITED_S
        costly = [] if has_waited else [name for name in wished if name not in cheap]
        left -= sum(self._costs.get(name, 0.0) for name in cheap)
        chosen = set(cheap)
        for turn, name in enumerate(sorted(costly, key=lambda name: self._drawn.get(name, 0.0))):
            left -= self._costs[name]
            if turn and left < 0:
                break
            chosen.add(name)
        return tuple(name for name in wished if name in chosen)

    def note(self, result: Result, costs: Mapping[str, float]) -> None:
        """Note what a window's estimate and its pictures took, s."""
        now = self._clock()
        self._runtime_s += _SMOOTHING * (result.wall_s - self._runtime_s)
        for name, cost in costs.items():
            before = self._costs.get(name, cost)
            self._costs[name] = before + _SMOOTHING * (cost - before)
            self._drawn[name] = now
