"""The numbers that the node counts, and the verdict on the node that its diagnostics give."""

import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import psutil

from emoflow_ros.core.bounded_windows import DistinctEvents
from emoflow_ros.core.estimate import Status
from emoflow_ros.node.tasks import Loss, Result, Task

_LATENCIES_KEPT = 200
# Why messages may hold no event that can be used.
_REFUSALS = {
    "malformed_messages": "malformed messages: check the driver's message version",
    "wrong_size_messages": "messages of another sensor size: give this sensor's calibration",
    "unordered_messages": "messages in which event time jumps: check the driver",
    "events_unordered": "events out of order: check the driver",
    "events_outside": "events outside the calibration's image: give this sensor's calibration",
}
_SOME_ARE_USUAL = ("events_outside", "events_unordered")  # glitches of sensors and hosts
_TOO_FAST = (
    "events come faster than the node decodes them; lower their rate, or give the node more of the "
    "processor"
)
_WARNINGS = {
    "worker_restarts": "worker restarts: {loss}",
    "windows_failed": "windows failed: {loss}",
    "slices_failed": "slices failed, so motions of now are missing: {loss}",
    "windows_diverged": "windows diverged: check the calibration, or give longer windows",
    "messages_skipped": f"messages left out: {_TOO_FAST}",
    "messages_in_part": f"messages decoded in part: {_TOO_FAST}",
    "windows_dropped": "windows dropped: {drop}",
    **{name: line for name, line in _REFUSALS.items() if name not in _SOME_ARE_USUAL},
    "time_jumps": "jumps in event time: the estimation starts anew",
}
_ALSO_COUNTED = (
    *("messages", "events", "events_thinned", "events_dropped", "seq_gaps", *_SOME_ARE_USUAL),
    *("internal_errors", "windows", "windows_forgotten", "twists_now"),
)
# Parts of the node that can have problems, the costliest first. With a problem of a mild part there
# are still estimates, so all other reasons of the same level come before it.
_PARTS = ("worker", "input", "qos", "camera", "frame")
_MILD = ("gyro", "scale", "device")

_STATUSES = tuple(f"windows_{status}" for status in Status)


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True)
class Report:
    """One diagnosis: how bad, why and what to do, and the numbers behind it."""

    level: Level
    message: str
    values: dict[str, str]


class Statistics:
    """Counts events on their way in and estimates on their way out.

    Counts are cumulative, by name; rates hold over the time between two reports.

    Args:
        clock: monotonic time in s.

    Attributes:
        counts: by name; all of them are there from the start.
        clock_drift_ppm: how much faster ROS time runs than the sensor's clock.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.counts: Counter[str] = Counter(
            dict.fromkeys((*_ALSO_COUNTED, *_STATUSES, *_WARNINGS), 0)
        )
        self.clock_drift_ppm = 0.0
        self.problems: dict[str, tuple[Level, str]] = {}
        self._clock = clock
        self._latencies: deque[float] = deque(maxlen=_LATENCIES_KEPT)
        self._last_result: Result | None = None
        self._last_loss = ""
        self._last_drop = ""
        self._dropped = DistinctEvents()
        self._dropped_epoch: int | None = None
        self._last_message = self._last_event = clock()
        self._reported = (clock(), Counter[str]())

    def add_events(self, count: int) -> None:
        """Count the events of one message that can be used."""
        self.counts["messages"] += 1
        self.counts["events"] += count
        self._last_message = self._clock()
        if count:
            self._last_event = self._last_message

    def add_malformed(self) -> None:
        """Count a message that cannot be read."""
        self.counts["malformed_messages"] += 1
        self._last_message = self._clock()

    def add_result(self, result: Result) -> None:
        """Count a window by what its events gave, and the latency since it was complete."""
        self.counts[f"windows_{result.estimate.by_events}"] += 1
        self._latencies.append(self._clock() - result.task.received)
        self._last_result = result

    def add_dropped(self, task: Task, reason: str) -> None:
        """Count a window that was dropped for this reason, and its events.

        Events that another dropped window also held are counted once.
        """
        if task.epoch != self._dropped_epoch:
            self._dropped_epoch = task.epoch
            self._dropped.start_anew()
        self._dropped.add(task.window)
        self.counts["windows_dropped"] += 1
        self.counts["events_dropped"] = self._dropped.count
        self._last_drop = reason

    def add_loss(self, loss: Loss) -> None:
        """Count a window or a worker that was lost, or both."""
        self.counts["worker_restarts"] += loss.worker
        self.counts["windows_failed"] += loss.task is not None
        self.counts["internal_errors"] += bool(loss.trace)
        self.counts["slices_failed"] += not (loss.worker or loss.task or loss.trace)
        self._last_loss = loss.reason

    def set_problem(self, part: str, level: Level, message: str) -> None:
        """State what is wrong with a part of the node, until it is cleared.

        Raises:
            ValueError: there is no such part.
        """
        if part not in _PARTS + _MILD:
            raise ValueError(f"no part of the node is called {part}")
        self.problems[part] = (level, message)

    def clear_problem(self, part: str) -> None:
        """State that a part of the node works."""
        self.problems.pop(part, None)

    def report(self, silence_s: float, worker: int | None = None) -> Report:
        """Judge the time since the last report.

        Args:
            silence_s: without events for this long the report warns.
            worker: the worker's process id, if there is one.
        """
        now = self._clock()
        before, counts = self._reported[0], self._reported[1]
        elapsed = max(now - before, 1e-9)
        current = self.counts.copy()
        self._reported = (now, current)
        level, message = self._verdict(now, current - counts, silence_s)
        done = sum(current[name] - counts[name] for name in _STATUSES)
        values = {
            "events_per_s": f"{(current['events'] - counts['events']) / elapsed:.0f}",
            "windows_per_s": f"{done / elapsed:.2f}",
            "twists_now_per_s": f"{(current['twists_now'] - counts['twists_now']) / elapsed:.1f}",
            **self._quality(),
            "clock_drift_ppm": f"{self.clock_drift_ppm:.1f}",
            "memory_mb": f"{resident_mb(os.getpid()):.0f}",
            "worker_memory_mb": f"{resident_mb(worker) if worker else 0.0:.0f}",
            **{name: str(current[name]) for name in sorted(current)},
        }
        return Report(level, message, values)

    def _verdict(self, now: float, recent: Counter[str], silence_s: float) -> tuple[Level, str]:
        """Choose the first of the worst reasons."""
        reasons = self._reasons(now, recent, silence_s)
        return max(reasons, key=lambda reason: reason[0], default=(Level.OK, "running"))

    def _reasons(
        self, now: float, recent: Counter[str], silence_s: float
    ) -> Iterator[tuple[Level, str]]:
        """Yield the reasons that hold, the costliest first."""
        yield from (self.problems[part] for part in _PARTS if part in self.problems)
        if recent["internal_errors"]:
            yield (
                Level.ERROR,
                f"{recent['internal_errors']} errors in the node, their tracebacks are in the log: "
                f"{self._last_loss}",
            )
        if "input" not in self.problems:
            yield from self._silence(now, recent, silence_s)
        for name, reason in _WARNINGS.items():
            if recent[name]:
                text = reason.format(loss=self._last_loss, drop=self._last_drop)
                yield Level.WARN, f"{recent[name]} {text}"
        yield from _without_estimates(recent)
        yield from (self.problems[part] for part in _MILD if part in self.problems)

    def _silence(
        self, now: float, recent: Counter[str], silence_s: float
    ) -> Iterator[tuple[Level, str]]:
        silent = now - self._last_event
        if silent <= silence_s:
            return
        if now - self._last_message > silence_s:
            yield Level.WARN, f"no events for {silent:.1f} s: check the driver or the bag"
            return
        for name, reason in _REFUSALS.items():
            if recent[name]:
                yield Level.ERROR, f"nothing to use for {silent:.1f} s: {recent[name]} {reason}"
        yield Level.WARN, f"messages without events for {silent:.1f} s: check the camera"

    def _quality(self) -> dict[str, str]:
        values = {}
        if self._latencies:
            p50, p95 = np.percentile(self._latencies, [50, 95]) * 1e3
            values["latency_p50_ms"] = f"{p50:.1f}"
            values["latency_p95_ms"] = f"{p95:.1f}"
        if self._last_result is not None:
            estimate = self._last_result.estimate
            values["status"] = str(estimate.status)
            values["model"] = str(estimate.model)
            values["iterations"] = str(estimate.quality.iterations)
            values["stop_reason"] = estimate.quality.stop_reason
            values["gyro"] = str(estimate.gyro)
        return values


def resident_mb(pid: int) -> float:
    """Resident memory of a process in MiB, 0 if it is gone or may not be looked at."""
    try:
        return float(psutil.Process(pid).memory_info().rss / 2**20)
    except psutil.Error:
        return 0.0


def _without_estimates(recent: Counter[str]) -> Iterator[tuple[Level, str]]:
    """Say why no window gave an estimate."""
    few, still = (recent[f"windows_{s}"] for s in (Status.TOO_FEW_EVENTS, Status.NO_MOTION))
    if recent[f"windows_{Status.OK}"]:
        return
    if few:
        yield (
            Level.WARN,
            f"{few} windows with too few events, and none with enough: the camera is at rest, or "
            "estimator.min_events is too high for its windows",
        )
    elif still:
        yield Level.OK, f"running, no motion in {still} windows"
