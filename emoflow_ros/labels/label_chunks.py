"""Chunks of a recording, labelled one by one: how they are cut, the work on one, who does it.

The windows of all chunks lie on one grid, counted from the recording's first event: together they
are the windows of a run without chunks. Before its own windows a chunk estimates those of its
margin, for the warm start only. This process does the work, or the workers of a Ray cluster do it.
"""

import math
import os
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any
from uuid import uuid4

from threadpoolctl import threadpool_limits

from emoflow_ros.core.config import Config
from emoflow_ros.core.events import NS_PER_S, Window, WindowPolicy
from emoflow_ros.core.factory import make_estimator
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.recording_options import Source
from emoflow_ros.evaluation.slicers import Interval, IntervalSlicer
from emoflow_ros.evaluation.window_run import attempt
from emoflow_ros.labels.label_file import Header, LabelWriter
from emoflow_ros.readers import Recording

LOCAL = "local"
_RETRIES = 3  # of a job whose worker died
_OBJECT_STORE = 80 << 20  # bytes, the least that Ray takes: jobs read and write files


@dataclass(frozen=True)
class Chunk:
    """A run of windows of one recording.

    Attributes:
        index: position in the recording.
        start: of the first window that is labelled, ns.
        windows: how many are labelled; those without any event are left out.
        margin: how many before them are estimated only.
    """

    index: int
    start: int
    windows: int
    margin: int

    def intervals(self, policy: WindowPolicy) -> list[Interval]:
        """All windows (start, end) in ns, those of the margin first."""
        duration, stride = policy.duration_ns, policy.stride_ns
        starts = (self.start + k * stride for k in range(-self.margin, self.windows))
        return [(start, start + duration) for start in starts]


@dataclass(frozen=True)
class Job:
    """All that is needed to label one chunk, in any process.

    Attributes:
        source: how the recording is opened.
        config: of windows and estimator.
        header: of the recording's label file.
        chunk: the windows.
        target: the file to write.
    """

    source: Source
    config: Config
    header: Header
    chunk: Chunk
    target: Path


def plan_chunks(
    span: tuple[int, int], policy: WindowPolicy, chunk_s: float, margin_s: float
) -> list[Chunk]:
    """Divide the whole windows of a recording.

    Args:
        span: times of the first and the last event, ns.
        policy: windows by time.
        chunk_s: about how long a chunk is, s; it holds at least one window.
        margin_s: how much is estimated before a chunk, s; where the recording goes so far back.

    Returns:
        The chunks in order; none where the recording is shorter than a window.
    """
    first, last = span
    duration, stride = policy.duration_ns, policy.stride_ns
    total = max(0, (last - first - duration) // stride + 1)
    size = max(1, round(chunk_s * NS_PER_S / stride))
    margin = math.ceil(margin_s * NS_PER_S / stride)
    return [
        Chunk(k // size, first + k * stride, min(size, total - k), min(margin, k))
        for k in range(0, total, size)
    ]


def event_span(recording: Recording) -> tuple[int, int]:
    """Find the times of a recording's first and last event, ns.

    Raises:
        InputError: damaged data, or no events.
    """
    first = next(int(events.t[0]) for events in recording.event_chunks() if len(events))
    back_s = 1.0  # a bag's duration is that of its log times
    while True:
        since = first
        if recording.duration is not None:
            since += max(0, round((recording.duration - back_s) * NS_PER_S))
        last = max((int(e.t[-1]) for e in recording.event_chunks(since) if len(e)), default=None)
        if last is not None:
            return first, last
        back_s *= 10


def label_chunk(job: Job) -> str:
    """Estimate a chunk's windows and write them; the file appears in one step when it is whole.

    Returns:
        Nothing, or in one line why it could not be done.
    """
    partial = job.target.with_name(f"{job.target.name}.{uuid4().hex}.partial")
    try:
        with (
            job.source.open() as recording,
            LabelWriter(partial, job.header, job.chunk.index) as writer,
        ):
            _estimate(job, recording, writer)
        os.replace(partial, job.target)
    except InputError as error:
        return str(error)
    except Exception as error:  # one recording must not stop the others
        traceback.print_exc()
        return f"{job.source.path}: {type(error).__name__}: {' '.join(str(error).split())}"
    finally:
        partial.unlink(missing_ok=True)
    return ""


def _estimate(job: Job, recording: Recording, writer: LabelWriter) -> None:
    """Estimate all windows, in one thread: cores work on chunks of their own."""
    estimator = make_estimator(job.header.camera, job.config)
    with threadpool_limits(1):
        for window in _windows(recording, job.chunk.intervals(job.config.window)):
            estimate, note = attempt(estimator, window)
            if window.t_start >= job.chunk.start:
                writer.append(window, estimate, note)


def _windows(recording: Recording, intervals: list[Interval]) -> Iterator[Window]:
    """Cut the windows; what follows them is not read."""
    slicer = IntervalSlicer(intervals)
    for events in recording.event_chunks(intervals[0][0]):
        yield from slicer.push(events)
        if len(events) and events.t[-1] >= intervals[-1][1]:
            return


# Does the jobs and yields each with what `label_chunk` returned, in the order of completion.
JobRunner = Callable[[Iterable[Job]], Iterator[tuple[Job, str]]]


def run_here(jobs: Iterable[Job]) -> Iterator[tuple[Job, str]]:
    """Do one job after the other in this process."""
    return ((job, label_chunk(job)) for job in jobs)


@contextmanager
def ray_workers(address: str, count: int | None) -> Generator[JobRunner]:
    """Connect to a Ray cluster.

    A job whose worker dies is done again by another one, up to 3 times.

    Args:
        address: of a running cluster, or `local` to start one on this machine for this run.
        count: jobs at once; None for as many as there are cores.

    Raises:
        InputError: Ray is not installed, or there is no cluster at the address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        ray = import_module("ray")
    except ImportError:
        raise InputError("--ray", "Ray is not installed", "run 'pip install ray'") from None
    start: dict[str, Any] = {}
    if address == LOCAL:
        start = {
            "num_cpus": count,
            "include_dashboard": False,
            "object_store_memory": _OBJECT_STORE,
        }
    try:
        ray.init(address, logging_level="ERROR", **start)
    except (ConnectionError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise InputError(
            f"--ray {address}", f"no cluster ({reason})", "give host:port of one, or local"
        ) from None
    try:
        yield _RayRun(ray, count or int(ray.cluster_resources()["CPU"]))
    finally:
        ray.shutdown()


class _RayRun:
    """Keeps as many jobs in flight as wanted."""

    def __init__(self, ray: Any, count: int) -> None:
        self._ray = ray
        self._count = count
        self._label = ray.remote(max_retries=_RETRIES)(label_chunk)

    def __call__(self, jobs: Iterable[Job]) -> Iterator[tuple[Job, str]]:
        waiting = iter(jobs)
        flying = {self._label.remote(job): job for job in islice(waiting, self._count)}
        while flying:
            (done,), _ = self._ray.wait(list(flying))
            yield flying.pop(done), self._result(done)
            flying |= {self._label.remote(job): job for job in islice(waiting, 1)}

    def _result(self, done: Any) -> str:
        try:
            return str(self._ray.get(done))
        except self._ray.exceptions.RayError as error:
            return f"the worker was lost ({' '.join(str(error).split())})"
