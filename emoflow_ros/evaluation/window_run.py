"""Run an estimator over a recording, window by window, and compare it with the truth.

A thread compares a window's estimate while the next window is estimated.
"""

import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, Estimator, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, Window
from emoflow_ros.core.types.gyro import GyroReadings
from emoflow_ros.errors import InputError, keep_traceback
from emoflow_ros.evaluation.benchmark_sequences import Published
from emoflow_ros.evaluation.estimates_file import EstimatesWriter
from emoflow_ros.evaluation.run_progress import Checkpoint, Gallery, Progress
from emoflow_ros.evaluation.slicers import EndingSlicer, Slicer, compared_part
from emoflow_ros.evaluation.window_results import WindowResult, assess
from emoflow_ros.readers import Recording, require_camera, unordered
from emoflow_ros.truth import Truth
from emoflow_ros.truth.dsec_flow import Submission

# The total is given as text: tqdm drops the number when a recording is longer than announced.
_BAR = "{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total_fmt} s [{elapsed}<{remaining}{postfix}]"
_BAR_OF_UNKNOWN_LENGTH = "{desc}: {n:.1f} s [{elapsed}{postfix}]"


@dataclass
class Evaluation:
    """The outcome of a run.

    Attributes:
        source: the recording.
        topic: its event topic.
        camera: its camera.
        truth: what it was compared with.
        protocol: which windows were compared, in words.
        windows: one result per window.
        events: of the recording in the windows, as they were cut; each counts once.
        unordered: events that were left out, because they are not in order of time.
        gallery: windows for pictures.
        interrupted: whether Ctrl-C ended it early.
        wall_s: time that the run took, s: reading, estimating and comparing.
        speed: of the camera, m/s, where it is given.
        published: figures of the paper to stand beside the summary.
        imu: whose gyro was used, in words; empty without one.
    """

    source: Path
    topic: str
    camera: Camera
    truth: Truth
    protocol: str = ""
    windows: list[WindowResult] = field(default_factory=list)
    events: int = 0
    unordered: int = 0
    gallery: Gallery = field(default_factory=Gallery)
    interrupted: bool = False
    wall_s: float = 0.0
    speed: float | None = None
    published: Published | None = None
    imu: str = ""

    @property
    def outcome(self) -> str:
        """How much was estimated, in words."""
        return outcome(sum(w.ok for w in self.windows), len(self.windows), self.unordered)


def outcome(ok: int, windows: int, unordered: int) -> str:
    """Say how many of so many windows were estimated, and how many events were left out."""
    left_out = f", {unordered} events out of order left out" if unordered else ""
    return f"{ok} of {windows} windows estimated{left_out}"


def evaluate(
    recording: Recording,
    estimator: Estimator,
    slicer: Slicer,
    truth: Truth,
    *,
    protocol: str = "",
    gyro: GyroReadings | None = None,
    writer: EstimatesWriter | None = None,
    max_windows: int | None = None,
    progress_bar: bool = False,
) -> Evaluation:
    """Estimate every window of a recording and compare it with the truth.

    Args:
        recording: opened, with a camera.
        estimator: made for the recording's camera.
        slicer: the window policy.
        truth: may be empty.
        protocol: the slicer's windows in words, for the report.
        gyro: readings for the windows, where a gyro is used.
        writer: receives every estimate, if given.
        max_windows: where to stop, if not at the recording's end.
        progress_bar: whether to show a bar over the recording's time.

    Raises:
        InputError: no camera, damaged data, or not one whole window.
    """
    return proceed(
        recording,
        Progress(estimator, slicer),
        truth,
        protocol=protocol,
        gyro=gyro,
        writer=writer,
        max_windows=max_windows,
        progress_bar=progress_bar,
    )


def proceed(
    recording: Recording,
    progress: Progress,
    truth: Truth,
    *,
    protocol: str = "",
    gyro: GyroReadings | None = None,
    writer: EstimatesWriter | None = None,
    submission: Submission | None = None,
    checkpoint: Checkpoint | None = None,
    max_windows: int | None = None,
    progress_bar: bool = False,
) -> Evaluation:
    """Do what is left of an evaluation; see `evaluate`.

    A window in which the estimator raises an exception is recorded with it and the next one
    starts cold. Ctrl-C ends the run and keeps what is done.

    Args:
        progress: a new run's, or that of a checkpoint.
        submission: receives the flow that a benchmark asks for, if given.
        checkpoint: where progress is saved now and then, and removed at the end.
    """
    run = Evaluation(
        recording.path,
        recording.topic,
        require_camera(recording),
        truth,
        protocol,
        progress.windows,
        gallery=progress.gallery,
    )
    left = None if max_windows is None else max(0, max_windows - len(run.windows))
    with (
        tqdm(
            total=None if recording.duration is None else round(recording.duration, 3),
            desc=recording.path.name,
            unit="s",
            disable=not progress_bar,
            bar_format=_BAR_OF_UNKNOWN_LENGTH if recording.duration is None else _BAR,
        ) as bar,
        threadpool_limits(1, "blas"),  # the products are small, and two threads use the cores
        ThreadPoolExecutor(1, "compare") as aside,
    ):
        began, comparing = time.perf_counter(), Future[None]()
        comparing.set_result(None)
        try:
            for window in islice(_windows(recording, progress), left):
                timed = window if gyro is None else window.with_gyro(gyro)
                estimate, note = attempt(progress.estimator, timed)
                comparing.result()
                progress.covered.add(window)
                progress.pending.popleft()
                comparing = aside.submit(
                    _compare, progress, window, estimate, note, truth, writer, submission
                )
                if checkpoint is not None and checkpoint.is_due():
                    comparing.result()
                    began = _count_time(progress, began)
                    if writer is not None:
                        writer.write()
                    checkpoint.save(progress)
                bar.set_postfix_str(_progress_line(run), refresh=False)
                bar.update((window.t_end - (progress.first or 0)) / NS_PER_S - bar.n)
            comparing.result()
            bar.set_postfix_str(_progress_line(run))
        except KeyboardInterrupt:
            run.interrupted = True
        _count_time(progress, began)
    if isinstance(error := comparing.exception(), Exception):  # beside Ctrl-C
        raise error
    if run.interrupted and writer is not None:
        writer.truncate(len(run.windows))  # Ctrl-C may have come in the middle of a row
    run.wall_s = progress.wall_s
    run.events = progress.covered.count
    run.unordered = unordered(recording)
    if checkpoint is not None and not run.interrupted:
        checkpoint.remove()
    return run


def attempt(estimator: Estimator, window: Window) -> tuple[Estimate, str]:
    """Estimate a window; an exception does not affect other windows.

    Returns:
        The estimate and an empty note, or one without values (`diverged`) and the exception in
        words, with the file of its traceback. The next window starts cold then.
    """
    try:
        return estimator.estimate(window), ""
    except Exception as error:
        estimator.reset()
        quality = Quality(events=0, stop_reason=Status.DIVERGED)
        middle = (window.t_start + window.t_end) // 2
        nothing = Estimate(window.t_start, window.t_end, middle, Status.DIVERGED, quality)
        return nothing, f"{type(error).__name__}: {error}{keep_traceback(error)}"


def _windows(recording: Recording, progress: Progress) -> Iterator[Window]:
    """Yield the windows that are left, the pending ones first.

    Raises:
        InputError: the recording ends before the first window is complete.
    """
    last = progress.first
    cut = bool(progress.windows or progress.pending)
    yield from _pending(progress)
    for events in _skip(recording.event_chunks(), progress.events):
        if progress.first is None:
            progress.first = int(events.t[0])
        last = int(events.t[-1])
        progress.pending.extend(progress.slicer.push(events))
        progress.events += len(events)
        cut = cut or bool(progress.pending)
        yield from _pending(progress)
    if isinstance(progress.slicer, EndingSlicer):
        progress.pending.extend(progress.slicer.finish())
        cut = cut or bool(progress.pending)
        yield from _pending(progress)
    if not cut and progress.first is not None and last is not None:
        raise InputError(
            recording.path,
            f"its events span {(last - progress.first) / NS_PER_MS:.1f} ms, less than one window",
            "give a shorter one with --window-ms",
        )


def _pending(progress: Progress) -> Iterator[Window]:
    while progress.pending:
        yield progress.pending[0]


def _skip(chunks: Iterator[Events], count: int) -> Iterator[Events]:
    """Leave out the first `count` events and empty chunks."""
    for events in chunks:
        if len(events) > count:
            yield events[count:]
        count = max(0, count - len(events))


def _compare(
    progress: Progress,
    window: Window,
    estimate: Estimate,
    note: str,
    truth: Truth,
    writer: EstimatesWriter | None,
    submission: Submission | None,
) -> None:
    """Compare a window's estimate with the truth, and keep it."""
    window = window.since(estimate.t_start)
    tracker = progress.tracker
    tracks = tracker.follow(estimate, truth) if tracker else None
    track_errors = tracks.errors if tracks else None
    result = assess(len(progress.windows), window, estimate, truth, note, track_errors)
    result = replace(result, relative_speed=progress.pace.follow(estimate))
    if writer is not None:
        writer.append(estimate, len(window.events), tracks)
    part = compared_part(window)
    if submission is not None:
        submission.offer(part.t_start, part.t_end, estimate)
    progress.gallery.offer(part, estimate, result, tuple(tracker.recent) if tracker else ())
    progress.windows.append(result)


def _count_time(progress: Progress, began: float) -> float:
    """Add the time since then to the run's, and return the present."""
    now = time.perf_counter()
    progress.wall_s += now - began
    return now


def _progress_line(run: Evaluation) -> str:
    line = f"{len(run.windows)} windows"
    epe = [w.flow.epe_px for w in run.windows[-20:] if w.flow]
    return f"{line}, EPE {sum(epe) / len(epe):.2f} px" if epe else line
