"""Which windows are estimated and compared: freely cut ones, or a benchmark's intervals."""

from collections import deque
from collections.abc import Mapping
from collections.abc import Sequence as Ordered
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.events import Events
from emoflow_ros.core.windows import NS_PER_S, Window, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.offline.checkpoint import Slicer
from emoflow_ros.offline.frames import frame_stamps
from emoflow_ros.offline.readers import Recording
from emoflow_ros.offline.sequences import Sequence
from emoflow_ros.offline.truth import FlowSource, PropagatedFlow, TrueFlow, Truth

WINDOWS = "windows"
# Frames from the start to the end of an interval.
FRAME_STEPS = {"mvsec-dt1": 1, "mvsec-dt4": 4}
_PUBLISHED_STEP = 4
PROTOCOLS = (WINDOWS, *FRAME_STEPS)


@dataclass(frozen=True)
class Plan:
    """How a recording is evaluated.

    Attributes:
        slicer: cuts the windows.
        truth: what counts of the truth.
        description: the protocol in words, for the report.
        published: figures of the paper that may stand beside the result.
    """

    slicer: Slicer
    truth: Truth
    description: str
    published: Mapping[str, float] = field(default_factory=dict)


def make_plan(
    protocol: str,
    recording: Recording,
    truth: Truth,
    policy: WindowPolicy,
    sequence: Sequence | None = None,
) -> Plan:
    """Prepare a protocol.

    `windows` cuts the stream by `policy`. `mvsec-dt1` and `mvsec-dt4` estimate one window for
    every frame, up to the 1st and 4th frame after it, from the events in between and no others.

    Raises:
        InputError: an unknown protocol, or a recording without frames.
    """
    crop = ""
    if sequence is not None and truth.flows is not None:
        truth = replace(truth, flows=CroppedFlow(truth.flows, sequence.rows))
        crop = f"; rows above {sequence.rows} of {sequence.camera.height} count"
    if protocol == WINDOWS:
        cut = (
            f"windows of {policy.count} events"
            if policy.count
            else f"windows of {policy.duration_ms:g} ms every "
            f"{policy.stride_ms or policy.duration_ms:g} ms"
        )
        return Plan(WindowSlicer(policy), truth, cut + crop)
    if protocol not in FRAME_STEPS:
        raise InputError(
            "--protocol", f"unknown protocol '{protocol}'", f"use one of {', '.join(PROTOCOLS)}"
        )
    stamps, source = _stamps(recording, truth)
    step = FRAME_STEPS[protocol]
    intervals = frame_intervals(stamps, step, sequence)
    if not intervals:
        raise InputError(
            recording.path,
            f"{len(stamps)} frames are too few for {protocol}"
            + (f" on {sequence.name}" if sequence else ""),
            "give the whole recording, or leave --sequence out",
        )
    description = (
        f"{protocol}: from every {source} to number {step} after it, {len(intervals)} intervals"
        + (f" of {sequence.name}" if sequence else "")
        + crop
    )
    published = sequence.published if sequence and step == _PUBLISHED_STEP else {}
    return Plan(IntervalSlicer(intervals), truth, description, published)


def frame_intervals(
    stamps: NDArray[np.int64], step: int, sequence: Sequence | None = None
) -> list[tuple[int, int]]:
    """List the intervals (start, end) in ns from each frame to the step-th after it.

    The sequence limits the frames that intervals start at (first to last, inclusive), and a
    segment the time that whole intervals lie in, counted from the first frame.
    """
    first, last = 0, len(stamps) - 1
    if sequence is not None:
        first = sequence.first_frame
        last = last if sequence.last_frame is None else min(last, sequence.last_frame)
    starts = range(first, min(last, len(stamps) - 1 - step) + 1)
    pairs = [(int(stamps[i]), int(stamps[i + step])) for i in starts]
    if sequence is not None and sequence.segment_s is not None and len(stamps):
        begin, end = (int(stamps[0]) + round(s * NS_PER_S) for s in sequence.segment_s)
        pairs = [(t0, t1) for t0, t1 in pairs if begin <= t0 and t1 <= end]
    return pairs


class IntervalSlicer:
    """Cut windows at given intervals, which start in order and may overlap.

    An interval is complete when an event at or after its end has been seen. Intervals without
    any event are left out.
    """

    def __init__(self, intervals: Ordered[tuple[int, int]]) -> None:
        self._intervals = deque(intervals)
        self._pending = Events.empty()

    def push(self, events: Events) -> list[Window]:
        """Take the next events and return the windows they complete."""
        self._pending = Events.concatenate([self._pending, events])
        windows = []
        while self._intervals and len(self._pending):
            start, end = self._intervals[0]
            if self._pending.t[-1] < end:
                break
            self._intervals.popleft()
            first, last = np.searchsorted(self._pending.t, [start, end])
            if last > first:
                windows.append(Window(start, end, self._pending[first:last]))
        if self._intervals:
            keep = int(np.searchsorted(self._pending.t, self._intervals[0][0]))
            self._pending = self._pending[keep:]
        else:
            self._pending = Events.empty()
        return windows


class CroppedFlow:
    """True flow of which only the upper rows count."""

    def __init__(self, source: FlowSource, rows: int) -> None:
        self.source = source
        self._rows = rows
        self.description = source.description

    def displacement(self, t0: int, t1: int) -> TrueFlow | None:
        """Return the source's displacement, not valid from row `rows` on."""
        flow = self.source.displacement(t0, t1)
        if flow is None:
            return None
        valid = flow.valid.copy()
        valid[self._rows :] = False
        return replace(flow, valid=valid)


def _stamps(recording: Recording, truth: Truth) -> tuple[NDArray[np.int64], str]:
    """Frames of the recording; where it has none, the stamps of the true flow."""
    stamps = frame_stamps(recording)
    if stamps is not None:
        return stamps, "frame"
    source = truth.flows.source if isinstance(truth.flows, CroppedFlow) else truth.flows
    if isinstance(source, PropagatedFlow):
        return source.stamps, "ground-truth stamp (the recording has no frames)"
    raise InputError(
        recording.path,
        "no frames, which the MVSEC protocols count in",
        "give the original bag or HDF5 file, or the flow truth with --gt",
    )
