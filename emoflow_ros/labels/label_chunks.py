"""One chunk of a recording: its windows are labelled, and the file that the labels are written to.

The windows of all chunks lie on one grid, counted from the recording's first event: together they
are the windows of a run without chunks. Before its own windows a chunk estimates those of its
margin, for the warm start only. The files of all chunks are joined to the recording's label file,
an estimates file with dense flow; docs/labels.md is its description.
"""

import dataclasses
import json
import os
import shutil
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

import h5py
import numpy as np
from threadpoolctl import threadpool_limits

from emoflow_ros.config import Config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import Window, WindowPolicy
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.estimates_columns import COLUMNS, TEXT, Column
from emoflow_ros.evaluation.estimates_file import EstimatesWriter, lacking
from emoflow_ros.evaluation.metrics import event_mask
from emoflow_ros.evaluation.recording_options import Source
from emoflow_ros.evaluation.slicers import Interval, IntervalSlicer
from emoflow_ros.evaluation.window_run import attempt
from emoflow_ros.factory import make_estimator
from emoflow_ros.readers import Recording
from emoflow_ros.readers.stream_check import StreamCheck

UNORDERED = "events_unordered"  # attribute: events of the recording that were left out
_MORE = {
    "note": Column((), TEXT, "", "the exception, where the estimator raised one"),
    "chunk": Column((), "i8", "", "number of the chunk of time that the window was labelled in"),
}


@dataclass(frozen=True)
class Header:
    """What is the same for all windows of a recording, and decides its labels.

    Attributes:
        source: the recording as it was named.
        camera: its camera.
        configuration: option values by dotted name.
        provenance: see docs/labels.md.
    """

    source: str
    camera: Camera
    configuration: dict[str, Any]
    provenance: dict[str, Any]

    def check(self, path: Path) -> None:
        """See that an existing file was written for the same labels.

        Raises:
            InputError: it is of another run, of an earlier version, or damaged.
        """
        fix = "leave --resume out to start again"
        mine = {
            "camera": dataclasses.asdict(self.camera),
            "configuration": self.configuration,
            **self.provenance,
        }
        try:
            with h5py.File(path) as file:
                its = {name: json.loads(file.attrs[name]) for name in ("camera", "configuration")}
                its |= json.loads(file.attrs["provenance"])
                wrong = lacking(file, COLUMNS | _MORE)
        except (OSError, KeyError) as error:
            reason = " ".join(str(error).split())
            raise InputError(path, f"cannot be read ({reason})", fix) from None
        if wrong:
            raise InputError(path, wrong, fix)
        plain = json.loads(json.dumps(mine))
        differ = [name for name in plain if its.get(name) != plain[name]]
        if differ:
            raise InputError(path, f"of a run with another {' and '.join(differ)}", fix)


class LabelWriter:
    """Write labels window by window. Use as a context manager.

    Args:
        path: the file; it is replaced.
        header: what to write once.
        chunk: the number that all windows get in the column `chunk`.

    Raises:
        InputError: the file cannot be written.
    """

    def __init__(self, path: Path, header: Header, chunk: int) -> None:
        self._camera = header.camera
        self._chunk = chunk
        size = header.camera.height, header.camera.width
        valid = Column(size, "?", "", "pixels with an event of the window and a flow", chunk=1)
        self._writer = EstimatesWriter(
            path,
            camera=header.camera,
            source=header.source,
            configuration=header.configuration,
            save_flow=True,
            more={"valid": valid, **_MORE},
            attributes={"provenance": json.dumps(header.provenance)},
        )

    def append(self, window: Window, estimate: Estimate, note: str) -> None:
        """Add one window; `note` is the exception, if the estimator raised one."""
        events = window.since(estimate.t_start).events  # an estimate may be of its latest part
        seen = event_mask(events, self._camera.width, self._camera.height)
        more = {
            "valid": seen & (estimate.flow is not None),
            "note": note,
            "chunk": self._chunk,
        }
        self._writer.append(estimate, len(events), more=more)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, trace)


def merge(parts: Sequence[Path], target: Path) -> None:
    """Join the rows of label files in the order given; the target appears in one step.

    The events that were left out add up.
    """
    partial = target.with_name(f"{target.name}.partial")
    shutil.copyfile(parts[0], partial)
    with h5py.File(partial, "r+") as whole:
        for part in parts[1:]:
            with h5py.File(part) as file:
                for name, dataset in whole.items():
                    _append(dataset, file[name])
                whole.attrs[UNORDERED] += file.attrs[UNORDERED]
    os.replace(partial, target)


def _append(dataset: h5py.Dataset, rows: h5py.Dataset) -> None:
    start = len(dataset)
    dataset.resize(start + len(rows), axis=0)
    if dataset.chunks[0] > 1:
        dataset[start:] = rows[:]
        return
    corner = (0,) * (dataset.ndim - 1)
    for row in range(len(rows)):  # dense rows are copied as they are, compressed
        filters, data = rows.id.read_direct_chunk((row, *corner))
        dataset.id.write_direct_chunk((start + row, *corner), data, filters)


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
            left_out = _estimate(job, recording, writer)
        with h5py.File(partial, "r+") as file:
            file.attrs[UNORDERED] = left_out
        os.replace(partial, job.target)
    except InputError as error:
        return str(error)
    except Exception as error:  # one recording must not stop the others
        traceback.print_exc()
        return f"{job.source.path}: {type(error).__name__}: {' '.join(str(error).split())}"
    finally:
        partial.unlink(missing_ok=True)
    return ""


def _estimate(job: Job, recording: Recording, writer: LabelWriter) -> int:
    """Estimate all windows, in one thread: cores work on chunks of their own.

    Returns:
        How many events of the chunk were left out, because they are not in order of time.
    """
    estimator = make_estimator(job.header.camera, job.config)
    policy, chunk = job.config.window, job.chunk
    intervals = chunk.intervals(policy)
    left_out = LeftOut(chunk.start, chunk.start + chunk.windows * policy.stride_ns)
    with threadpool_limits(1):
        for window in chunk_windows(recording, intervals, left_out):
            estimate, note = attempt(estimator, window)
            if window.t_start >= job.chunk.start:
                writer.append(window, estimate, note)
    return left_out.count


class LeftOut:
    """Counts the events of a chunk's windows that were left out; no other chunk counts them.

    Args:
        start, end: of the chunk's first window and of the next chunk's, ns.
    """

    def __init__(self, start: int, end: int) -> None:
        self._start, self._end = start, end
        self.count = 0

    def note(self, check: StreamCheck | None) -> None:
        """Take what the latest chunk of events has left out."""
        gaps = check.order.gaps if check else np.empty(0, np.int64)
        self.count += int(np.count_nonzero((gaps >= self._start) & (gaps < self._end)))


def chunk_windows(
    recording: Recording, intervals: list[Interval], left_out: LeftOut | None = None
) -> Iterator[Window]:
    """Cut the windows of these intervals; what follows the last one is not read."""
    slicer = IntervalSlicer(intervals)
    for events in recording.event_chunks(intervals[0][0]):
        if left_out:
            left_out.note(recording.check)
        yield from slicer.push(events)
        if len(events) and events.t[-1] >= intervals[-1][1]:
            return
