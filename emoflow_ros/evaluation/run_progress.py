"""What a run keeps between two windows: its results so far, and windows for the report's pictures.

A checkpoint saves it, so that a stopped run continues exactly where it was.
"""

import copyreg
import math
import os
import pickle
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from emoflow_ros.core.stream.bounded_windows import DistinctEvents
from emoflow_ros.core.types.estimate import Estimate, Estimator
from emoflow_ros.core.types.events import Window
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.relative_speed import RelativeSpeed
from emoflow_ros.evaluation.slicers import Slicer
from emoflow_ros.evaluation.track_errors import ComparedTracks, TrackComparer
from emoflow_ros.evaluation.window_results import WindowResult

WORST = 5
_CAPACITY = 8
PERIOD_S = 10.0

# Estimators hold handles of loaded libraries. They are not saved; loading finds them again.
copyreg.pickle(ThreadpoolController, lambda _: (ThreadpoolController, ()))


@dataclass(frozen=True)
class Example:
    """A window with all that its pictures need; `tracks` has the tracks up to it, its own last."""

    title: str
    window: Window
    estimate: Estimate
    result: WindowResult
    tracks: Sequence[ComparedTracks] = ()

    @property
    def error(self) -> float:
        """The figure that ranks examples: EPE, or minus the contrast gain without a truth."""
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
        tracks: Sequence[ComparedTracks] = (),
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
    """Copy the events out of their chunk, so that the chunk can be freed."""
    every = np.ones(len(window.events), np.bool_)
    return Window(window.t_start, window.t_end, window.events[every])


@dataclass
class Progress:
    """All that a run needs to go on, between two windows.

    Attributes:
        estimator, slicer: with what they have learnt and kept.
        events: how many events of the stream the slicer has taken.
        first: time of the first event, ns; None before it.
        pending: windows that are cut but not yet estimated.
        windows: the results so far.
        covered: counts the events of their windows.
        gallery: the windows kept for pictures.
        tracker: carries points along, if wanted.
        pace: how fast the camera goes, relative to earlier.
        wall_s: time that the run has taken so far, s.
    """

    estimator: Estimator
    slicer: Slicer
    events: int = 0
    first: int | None = None
    pending: deque[Window] = field(default_factory=deque)
    windows: list[WindowResult] = field(default_factory=list)
    covered: DistinctEvents = field(default_factory=DistinctEvents)
    gallery: Gallery = field(default_factory=Gallery)
    tracker: TrackComparer | None = None
    pace: RelativeSpeed = field(default_factory=RelativeSpeed)
    wall_s: float = 0.0


class Checkpoint:
    """The file that holds a run's progress.

    It is a pickle: read only what this machine has written.

    Args:
        path: the file.
        identity: what a run that continues must have in common: recording, options, versions.
    """

    def __init__(self, path: Path, identity: Mapping[str, Any]) -> None:
        self._path = path
        self._identity = dict(identity)
        self._saved_at = time.monotonic()

    def load(self) -> Progress | None:
        """Return the progress of an unfinished run; None where there is none.

        Raises:
            InputError: it belongs to another run, or the file is damaged.
        """
        if not self._path.exists():
            return None
        fix = "leave --resume out to start again"
        try:
            with self._path.open("rb") as file:
                identity, progress = pickle.load(file)
        except Exception as error:  # a damaged pickle raises anything
            wrong = f"damaged checkpoint ({' '.join(str(error).split())})"
            raise InputError(self._path, wrong, fix) from None
        differ = [name for name in self._identity if identity.get(name) != self._identity[name]]
        if differ:
            raise InputError(self._path, f"of a run with another {' and '.join(differ)}", fix)
        assert isinstance(progress, Progress)
        return progress

    def is_due(self) -> bool:
        """Tell whether it was saved 10 s ago."""
        return time.monotonic() - self._saved_at >= PERIOD_S

    def save(self, progress: Progress) -> None:
        """Replace the file in one step, so that there is always a whole one."""
        partial = self._path.with_suffix(".partial")
        with partial.open("wb") as file:
            pickle.dump((self._identity, progress), file, protocol=pickle.HIGHEST_PROTOCOL)
        os.replace(partial, self._path)
        self._saved_at = time.monotonic()

    def remove(self) -> None:
        """Forget a finished run."""
        self._path.unlink(missing_ok=True)
