"""The numbers that the node counts, and the verdict on the node that its diagnostics give."""

import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator

import numpy as np
import psutil

from emoflow_ros.core.products.wide import why_wide
from emoflow_ros.core.stream.bounded_windows import DistinctEvents
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.node.event_share import EventShare
from emoflow_ros.node.reports import Level, Report
from emoflow_ros.node.stream_watch import DROPPED, FAILED, REFUSALS, StreamWatch
from emoflow_ros.node.tasks import Loss, Result, Task
from emoflow_ros.node.worker_load import WorkerLoad

_LATENCIES_KEPT = 200
_SOME_ARE_USUAL = ("events_outside", "events_unordered")  # glitches of sensors and hosts
_TOO_FAST = (
    "events come faster than the node decodes them; lower their rate, or give the node more of the "
    "processor"
)
_FEWER = "; windows hold at most 1/{part} of the usual events, as they find the worker busy"
_WARNINGS = {
    "worker_restarts": "worker restarts: {loss}",
    "windows_failed": "windows failed: {loss}",
    "slices_failed": "slices failed, so latest twists are missing: {loss}",
    "windows_diverged": "windows diverged: check the calibration, or give longer windows",
    "messages_skipped": f"messages left out: {_TOO_FAST}",
    "messages_in_part": f"messages decoded in part: {_TOO_FAST}",
    "windows_dropped": "windows dropped: {drop}",
    **{name: line for name, line in REFUSALS.items() if name not in _SOME_ARE_USUAL},
    "time_jumps": "jumps in event time: the estimation starts anew",
}
_ALSO_COUNTED = (
    *("messages", "events", "events_thinned", "events_dropped", "seq_gaps", *_SOME_ARE_USUAL),
    *("internal_errors", "windows", "windows_forgotten", "twists_now"),
    "pictures_left_out",
    "wrong_stamps",
)
# Parts of the node that can have problems, the costliest first. With a problem of a mild part there
# are still estimates, so all other reasons of the same level come before it.
_PARTS = ("worker", "busy", "input", "qos", "camera", "frame", "topic")
_MILD = ("gyro", "scale", "device")

_STATUSES = tuple(f"windows_{status}" for status in Status)


class Statistics:
    """Counts events on their way in and estimates on their way out.

    Counts are cumulative, by name; rates hold over the time between two reports.

    Args:
        clock: monotonic time in s.

    Attributes:
        counts: by name; all of them are there from the start.
        stream: what comes in and goes out; told by `listen` and `give` from outside.
        load: how much of the processor the worker gets.
        share: how many events windows may hold.
        event_delay_s: of event times on ROS time behind the messages' stamps; 0 on another clock.
        clock_drift_ppm: how much faster ROS time runs than the sensor's clock.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.counts: Counter[str] = Counter(
            dict.fromkeys((*_ALSO_COUNTED, *_STATUSES, *_WARNINGS), 0)
        )
        self.clock_drift_ppm = self.event_delay_s = 0.0
        self.share = EventShare(clock)
        self.problems: dict[str, tuple[Level, str]] = {}
        self._clock = clock
        self._latencies: deque[float] = deque(maxlen=_LATENCIES_KEPT)
        self._last_result: Result | None = None
        self._last_loss = ""
        self._last_drop = ""
        self._dropped = DistinctEvents()
        self._dropped_epoch: int | None = None
        self.stream = StreamWatch(self.counts, clock)
        self.load = WorkerLoad()
        self._reported = (clock(), Counter[str]())

    def add_events(self, count: int) -> None:
        """Count the events of one message that can be used."""
        self.counts["messages"] += 1
        self.counts["events"] += count
        self.stream.take(count)

    def add_malformed(self) -> None:
        """Count a message that cannot be read."""
        self.counts["malformed_messages"] += 1
        self.stream.take(0)

    def add_result(self, result: Result) -> None:
        """Count a window by what its events gave, and the latency since it was complete."""
        self.counts[f"windows_{result.estimate.by_events}"] += 1
        self._latencies.append(self._clock() - result.task.received)
        self._last_result = result
        self.load.add(result)
        self.counts["pictures_left_out"] += result.left_out
        if not result.estimate.told:
            self.stream.miss(result.estimate.status, result.estimate.quality.stop_reason)

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
        self.stream.miss(DROPPED, reason)

    def add_loss(self, loss: Loss) -> None:
        """Count a window or a worker that was lost, or both."""
        self.counts["worker_restarts"] += loss.worker
        self.counts["windows_failed"] += loss.task is not None
        self.counts["internal_errors"] += bool(loss.trace)
        self.counts["slices_failed"] += not (loss.worker or loss.task or loss.trace)
        self._last_loss = loss.reason
        if loss.task is not None:
            self.stream.miss(FAILED, loss.reason)

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

    def report(
        self, silence_s: float, worker: int | None = None, *, twist_s: float = 1.0
    ) -> Report:
        """Judge the time since the last report.

        Args:
            silence_s: without events for this long the report warns.
            twist_s: without a twist for this long, although events come, it warns, too.
            worker: the worker's process id, if there is one.
        """
        now = self._clock()
        before, counts = self._reported[0], self._reported[1]
        elapsed = max(now - before, 1e-9)
        current = self.counts.copy()
        self._reported = (now, current)
        level, message = self._verdict(current - counts, silence_s, twist_s)
        done = sum(current[name] - counts[name] for name in _STATUSES)
        values = {
            "events_per_s": f"{(current['events'] - counts['events']) / elapsed:.0f}",
            "windows_per_s": f"{done / elapsed:.2f}",
            "twists_now_per_s": f"{(current['twists_now'] - counts['twists_now']) / elapsed:.1f}",
            **self._quality(),
            "events_share": f"{1 / self.share.part:g}",
            "clock_drift_ppm": f"{self.clock_drift_ppm:.1f}",
            "memory_mb": f"{resident_mb(os.getpid()):.0f}",
            "worker_memory_mb": f"{resident_mb(worker) if worker else 0.0:.0f}",
            **{name: str(current[name]) for name in sorted(current)},
        }
        return Report(level, message, values)

    def _verdict(self, recent: Counter[str], silence_s: float, twist_s: float) -> tuple[Level, str]:
        """Choose the first of the worst reasons."""
        reasons = self._reasons(recent, silence_s, twist_s)
        running = Level.OK, self._running(recent) + self._fewer
        return max(reasons, key=lambda reason: reason[0], default=running)

    @property
    def _fewer(self) -> str:
        part = self.share.part
        return "" if part == 1 else _FEWER.format(part=part)

    def _running(self, recent: Counter[str]) -> str:
        """Say what became of most windows, where few have an estimate, or that events pause."""
        if pause := self.stream.pause_s:
            return f"running; no events for {pause:.1f} s"
        done = sum(recent[name] for name in _STATUSES)
        most = max(_STATUSES, key=lambda name: recent[name])
        if most == f"windows_{Status.OK}" or 2 * recent[f"windows_{Status.OK}"] >= done:
            return "running"
        status = most.removeprefix("windows_")
        last = self._last_result
        if last is not None and status == str(last.estimate.by_events):
            why = why_wide(last.estimate)
            status += f" ({why})" if why else ""
        return f"running; {recent[most]} of {done} windows: {status.replace('_', ' ')}"

    def _reasons(
        self, recent: Counter[str], silence_s: float, twist_s: float
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
            yield from self.stream.silence(silence_s)
            yield from self.stream.missing_twists(twist_s)
        for name, reason in _WARNINGS.items():
            if recent[name]:
                drop = self._last_drop + self._fewer
                text = reason.format(loss=self._last_loss, drop=drop)
                yield Level.WARN, f"{recent[name]} {text}"
        yield from (self.problems[part] for part in _MILD if part in self.problems)

    def _quality(self) -> dict[str, str]:
        values = {}
        if self._latencies:
            p50, p95 = np.percentile(self._latencies, [50, 95]) * 1e3
            values["latency_p50_ms"] = f"{p50:.1f}"
            values["latency_p95_ms"] = f"{p95:.1f}"
            values["processor_share"] = f"{self.load.share:.2f}"
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
