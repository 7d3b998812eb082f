"""Snapshots of a run, so that a stopped one continues exactly where it was."""

import copyreg
import os
import pickle
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from threadpoolctl import ThreadpoolController

from emoflow_ros.core.estimate import Estimator
from emoflow_ros.core.event_count import DistinctEvents
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import Window
from emoflow_ros.errors import InputError
from emoflow_ros.offline.gallery import Gallery
from emoflow_ros.offline.results import WindowResult
from emoflow_ros.offline.tracks import Tracker

_PERIOD_S = 10.0

# Estimators hold handles of loaded libraries; these are not saved, but looked up again.
copyreg.pickle(ThreadpoolController, lambda _: (ThreadpoolController, ()))


class Slicer(Protocol):
    """Cuts a stream of events into windows, as core.windows.WindowSlicer does."""

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        ...


@runtime_checkable
class EndingSlicer(Slicer, Protocol):
    """A slicer that has windows left when the stream ends."""

    def finish(self) -> list[Window]:
        """Return the windows that would wait for events after the last ones."""
        ...


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
    tracker: Tracker | None = None
    wall_s: float = 0.0


class Checkpoint:
    """The file that holds a run's progress.

    It is a pickle: read only what this machine has written.

    Args:
        path: the file.
        identity: what has to be the same for a run to be continued: recording, options, versions.
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

    def save_if_due(self, progress: Progress) -> None:
        """Save every 10 s."""
        if time.monotonic() - self._saved_at >= _PERIOD_S:
            self.save(progress)

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
