"""Labels of many recordings: the chunks that are to be labelled, and the joining of those done."""

import math
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
from tqdm import tqdm

from emoflow_ros.config import Config
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import NS_PER_S, WindowPolicy
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.provenance import fingerprint, versions
from emoflow_ros.evaluation.recording_options import Source, make_folder
from emoflow_ros.evaluation.window_run import outcome
from emoflow_ros.labels.label_chunks import UNORDERED, Chunk, Header, Job, merge
from emoflow_ros.readers import Recording, require_camera

# Does the jobs and yields each with what `label_chunk` returned, in the order of completion.
JobRunner = Callable[[Iterable[Job]], Iterator[tuple[Job, str]]]


@dataclass(frozen=True)
class Settings:
    """What is the same for all recordings.

    Attributes:
        config: of windows (by time) and estimator.
        chunk_s: length of a chunk.
        margin_s: what is estimated before it.
        folder: where the label files go.
        resume: whether finished chunks of an earlier run count.
    """

    config: Config
    chunk_s: float
    margin_s: float
    folder: Path
    resume: bool = False

    def target(self, source: Source) -> Path:
        """Name the label file of a recording."""
        path = source.path.resolve()
        return self.folder / f"{path.name if path.is_dir() else path.stem}.h5"


@dataclass
class RecordingPlan:
    """One recording.

    Attributes:
        source: how it is opened.
        target: its label file.
        parts: the files of all chunks, in order; none where the label file is there already.
        jobs: chunks that are left to do.
        error: why it could not be labelled.
    """

    source: Source
    target: Path
    parts: list[Path] = field(default_factory=list)
    jobs: list[Job] = field(default_factory=list)
    error: str = ""


def label_all(sources: Sequence[Source], settings: Settings, run: JobRunner) -> list[RecordingPlan]:
    """Label recordings; one that fails does not affect the others.

    Ctrl-C leaves the finished chunks for a run that resumes.

    Args:
        sources: the recordings; their label files have different names.
        settings: the same for all of them.
        run: does the work on the chunks.

    Returns:
        One plan per recording, with its error if it failed.
    """
    plans = [_plan(source, settings) for source in tqdm(sources, desc="reading", leave=False)]
    by_name = {str(plan.source.path): plan for plan in plans}
    left = {name: len(plan.jobs) for name, plan in by_name.items()}
    for plan in plans:
        if not plan.jobs:
            _finish(plan)
    with tqdm(total=sum(left.values()), desc="labelling", unit="chunk") as bar:
        for job, error in run(_jobs(plans)):
            name = job.header.source
            left[name] -= 1
            bar.update()
            if error:
                _fail(by_name[name], error)
            elif left[name] == 0:
                _finish(by_name[name])
    return plans


def _plan(source: Source, settings: Settings) -> RecordingPlan:
    """Find out what is left to do for a recording."""
    plan = RecordingPlan(source, settings.target(source))
    folder = plan.target.with_suffix(".parts")
    try:
        with source.open() as recording:
            header = _header(source, recording, settings)
            if settings.resume and plan.target.exists():
                header.check(plan.target)
                return plan
            span = event_span(recording)
        chunks = plan_chunks(span, settings.config.window, settings.chunk_s, settings.margin_s)
        if not chunks:
            wrong = f"its events span {(span[1] - span[0]) / 1e6:.1f} ms, less than one window"
            raise InputError(source.path, wrong, "give a shorter one with --window-ms")
        _prepare(folder, settings.resume)
        absolute = source.resolved()
        for chunk in chunks:
            part = folder / f"{chunk.index:06d}.h5"
            plan.parts.append(part)
            if part.exists():
                header.check(part)
            else:
                plan.jobs.append(Job(absolute, settings.config, header, chunk, part.resolve()))
    except InputError as error:
        plan.jobs.clear()
        _fail(plan, str(error))
    return plan


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


def _header(source: Source, recording: Recording, settings: Settings) -> Header:
    provenance = {
        "recording": fingerprint(source.path),
        "topic": recording.topic,
        "columns": str(source.columns or ""),
        "chunks": {"length_s": settings.chunk_s, "margin_s": settings.margin_s},
        "versions": versions(),
    }
    camera = require_camera(recording)
    return Header(str(source.path), camera, settings.config.flat(), provenance)


def _prepare(folder: Path, resume: bool) -> None:
    """Make the folder of parts; without what an earlier run left, unless that counts."""
    if folder.exists() and not resume:
        shutil.rmtree(folder)
    make_folder(folder)
    for partial in folder.glob("*.partial"):
        partial.unlink()


def _jobs(plans: list[RecordingPlan]) -> Iterator[Job]:
    """Yield what is left to do, while its recording has not failed."""
    for plan in plans:
        for job in plan.jobs:
            if plan.error:
                break
            yield job


def _finish(plan: RecordingPlan) -> None:
    """Join the chunks of a recording, if that is not done yet, and remove them.

    A file without any label is kept, since it says why, but its recording counts as failed.
    """
    if plan.error:
        return
    try:
        if plan.parts:
            merge(plan.parts, plan.target)
        with h5py.File(plan.target) as file:
            status = file["status"].asstr()[:]
            left_out = int(file.attrs.get(UNORDERED, 0))
    except OSError as error:
        _fail(plan, f"{plan.target}: cannot be written ({error}); give another --out")
        return
    ok = int(sum(status == Status.OK))
    if plan.parts:
        shutil.rmtree(plan.parts[0].parent)
        tqdm.write(f"{plan.target}: {outcome(ok, len(status), left_out)}")
    else:
        tqdm.write(f"{plan.target}: there already")
    if not ok:
        wrong = f"none of its {len(status)} windows could be estimated"
        _fail(plan, f"{plan.source.path}: {wrong}; {plan.target} says why")


def _fail(plan: RecordingPlan, error: str) -> None:
    if not plan.error:
        plan.error = error
        tqdm.write(f"error: {error}", file=sys.stderr)
