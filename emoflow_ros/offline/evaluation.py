"""Run an estimator over a recording, window by window, and compare it with the truth."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from tqdm import tqdm

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate, Estimator, Quality, Status
from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.errors import InputError
from emoflow_ros.offline.estimates import EstimatesWriter
from emoflow_ros.offline.gallery import Gallery
from emoflow_ros.offline.readers import Recording, require_camera
from emoflow_ros.offline.results import WindowResult, assess
from emoflow_ros.offline.truth import Truth


class Slicer(Protocol):
    """Cuts a stream of events into windows, as core.windows.WindowSlicer does."""

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        ...


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
        gallery: windows for pictures.
        interrupted: whether Ctrl-C ended it early.
    """

    source: Path
    topic: str
    camera: Camera
    truth: Truth
    protocol: str = ""
    windows: list[WindowResult] = field(default_factory=list)
    gallery: Gallery = field(default_factory=Gallery)
    interrupted: bool = False


def evaluate(
    recording: Recording,
    estimator: Estimator,
    slicer: Slicer,
    truth: Truth,
    *,
    protocol: str = "",
    writer: EstimatesWriter | None = None,
    progress: bool = False,
) -> Evaluation:
    """Estimate every window of a recording and compare it with the truth.

    A window in which the estimator raises an exception is recorded as failed and the next one
    starts cold. Ctrl-C ends the run and keeps what is done.

    Args:
        recording: opened, with a camera.
        estimator: made for the recording's camera.
        slicer: the window policy.
        truth: may be empty.
        protocol: the slicer's windows in words, for the report.
        writer: receives every estimate, if given.
        progress: whether to show a bar over the recording's time.

    Raises:
        InputError: no camera, damaged data, or not one whole window.
    """
    camera = require_camera(recording)
    run = Evaluation(recording.path, recording.topic, camera, truth, protocol)
    with tqdm(
        total=recording.duration and round(recording.duration, 3),
        desc=recording.path.name,
        unit="s",
        disable=not progress,
        bar_format="{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total:.1f} s "
        "[{elapsed}<{remaining}{postfix}]",
    ) as bar:
        try:
            for window in _windows(recording, slicer, bar):
                result = _process(run, window, estimator, writer)
                run.windows.append(result)
                bar.set_postfix_str(_progress_line(run))
        except KeyboardInterrupt:
            run.interrupted = True
    return run


def _windows(recording: Recording, slicer: Slicer, bar: tqdm) -> Iterator[Window]:  # type: ignore[type-arg]
    """Yield the windows of a recording.

    Raises:
        InputError: the recording ends before the first one is complete.
    """
    first = last = None
    found = False
    for events in recording.event_chunks():
        if len(events) == 0:
            continue
        first = int(events.t[0]) if first is None else first
        last = int(events.t[-1])
        for window in slicer.push(events):
            found = True
            yield window
            bar.update((window.t_end - first) / NS_PER_S - bar.n)
    if not found and first is not None and last is not None:
        raise InputError(
            recording.path,
            f"its events span {(last - first) / NS_PER_MS:.1f} ms, less than one window",
            "give a shorter one with --window-ms",
        )


def _process(
    run: Evaluation, window: Window, estimator: Estimator, writer: EstimatesWriter | None
) -> WindowResult:
    note = ""
    try:
        estimate = estimator.estimate(window)
    except Exception as error:  # one window must not cost the others
        note = f"{type(error).__name__}: {error}"
        estimate = _no_estimate(window)
        estimator.reset()
    result = assess(len(run.windows), window, estimate, run.truth, note)
    if writer is not None:
        writer.append(estimate)
    run.gallery.offer(window, estimate, result)
    return result


def _no_estimate(window: Window) -> Estimate:
    return Estimate(
        t_start=window.t_start,
        t_end=window.t_end,
        t=(window.t_start + window.t_end) // 2,
        status=Status.DIVERGED,
        quality=Quality(events=len(window.events), stop_reason=Status.DIVERGED),
    )


def _progress_line(run: Evaluation) -> str:
    line = f"{len(run.windows)} windows"
    epe = [w.flow.epe_px for w in run.windows[-20:] if w.flow]
    return f"{line}, EPE {sum(epe) / len(epe):.2f} px" if epe else line
