"""The few windows of an evaluation whose pictures go into the report."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.windows import Window
from emoflow_ros.offline.results import WindowResult
from emoflow_ros.offline.tracks import Tracks

_CAPACITY = 8


@dataclass(frozen=True)
class Example:
    """A window with all that its pictures need; `tracks` are those up to it, its own last."""

    title: str
    window: Window
    estimate: Estimate
    result: WindowResult
    tracks: Sequence[Tracks] = ()


class Gallery:
    """Keep the best and the worst window, and an even sample to take the median from.

    Windows are ranked by EPE; where no window has a true flow, by contrast gain. Memory does
    not grow with the length of the recording.
    """

    def __init__(self) -> None:
        self._has_truth = False
        self._clear()

    def _clear(self) -> None:
        self._sample: list[Example] = []
        self._step = 1
        self._seen = 0
        self._best: Example | None = None
        self._worst: Example | None = None

    def offer(
        self,
        window: Window,
        estimate: Estimate,
        result: WindowResult,
        tracks: Sequence[Tracks] = (),
    ) -> None:
        """Consider one window; those without a flow are not shown."""
        if estimate.flow is None or (self._has_truth and result.flow is None):
            return
        if result.flow is not None and not self._has_truth:
            self._has_truth = True
            self._clear()
        example = Example("", window, estimate, result, tracks)
        if self._best is None or _error(example) < _error(self._best):
            self._best = example
        if self._worst is None or _error(example) > _error(self._worst):
            self._worst = example
        if self._seen % self._step == 0:
            self._sample.append(example)
        if len(self._sample) > _CAPACITY:
            self._sample = self._sample[::2]
            self._step *= 2
        self._seen += 1

    def examples(self) -> list[Example]:
        """Best, median and worst window, each shown once."""
        if self._best is None or self._worst is None:
            return []
        if self._best is self._worst:
            return [replace(self._best, title="The window")]
        ranked = sorted(self._sample, key=_error)
        named = {
            "Best window": self._best,
            "Median window": ranked[len(ranked) // 2],
            "Worst window": self._worst,
        }
        shown: dict[int, Example] = {}
        for title, example in named.items():
            shown.setdefault(example.result.index, replace(example, title=title))
        return list(shown.values())


def _error(example: Example) -> float:
    if example.result.flow is not None:
        return example.result.flow.epe_px
    gain = example.result.quality.contrast_gain
    return -gain if math.isfinite(gain) else math.inf
