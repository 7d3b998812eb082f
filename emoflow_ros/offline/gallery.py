"""The few windows of an evaluation whose pictures go into the report."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.windows import Window
from emoflow_ros.offline.results import WindowResult
from emoflow_ros.offline.tracks import Tracks

WORST = 5
_CAPACITY = 8


@dataclass(frozen=True)
class Example:
    """A window with all that its pictures need; `tracks` are those up to it, its own last."""

    title: str
    window: Window
    estimate: Estimate
    result: WindowResult
    tracks: Sequence[Tracks] = ()

    @property
    def error(self) -> float:
        """What examples are ranked by: EPE or, where no truth is known, contrast that is lost."""
        if self.result.flow is not None:
            return self.result.flow.epe_px
        gain = self.result.quality.contrast_gain
        return -gain if math.isfinite(gain) else math.inf


class Gallery:
    """Keep the best and the worst windows, and an even sample to take the median from.

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
        self._worst: list[Example] = []

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
        is_best = self._best is None or example.error < self._best.error
        is_bad = len(self._worst) < WORST or example.error > self._worst[-1].error
        is_sampled = self._seen % self._step == 0
        self._seen += 1
        if not (is_best or is_bad or is_sampled):
            return
        example = replace(example, window=_detached(example.window))
        if is_best:
            self._best = example
        if is_bad:
            self._worst = sorted([*self._worst, example], key=lambda e: -e.error)[:WORST]
        if is_sampled:
            self._sample.append(example)
        if len(self._sample) > _CAPACITY:
            self._sample = self._sample[::2]
            self._step *= 2

    def examples(self) -> list[Example]:
        """Best, median and worst windows, each shown once."""
        if self._best is None:
            return []
        ranked = sorted(self._sample, key=lambda e: e.error)
        named = [("Best window", self._best), ("Median window", ranked[len(ranked) // 2])]
        ordinals = ("Worst", "2nd worst", "3rd worst", "4th worst", "5th worst")
        named += [
            (f"{ordinal} window", example)
            for ordinal, example in zip(ordinals, self._worst, strict=False)
        ]
        shown: dict[int, Example] = {}
        for title, example in named:
            shown.setdefault(example.result.index, replace(example, title=title))
        return list(shown.values())

    def worst(self) -> list[WindowResult]:
        """The worst windows, the worst one first."""
        return [example.result for example in self._worst]


def _detached(window: Window) -> Window:
    """Copy the events out of the chunk that they are a part of, which can go then."""
    every = np.ones(len(window.events), np.bool_)
    return Window(window.t_start, window.t_end, window.events[every])
