"""Which windows are estimated and compared: freely cut ones, or a benchmark's intervals."""

from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.benchmark_sequences import (
    DSEC_CLIP,
    MVSEC_CLIP,
    PUBLISHED,
    BenchmarkSequence,
    Published,
)
from emoflow_ros.evaluation.slicers import (
    CausalSlicer,
    ClipSlicer,
    CroppedSlicer,
    Interval,
    Slicer,
    with_lead_in,
)
from emoflow_ros.readers import Recording
from emoflow_ros.readers.bag import BagRecording
from emoflow_ros.readers.bag_files import deserialize, open_bag, read_messages
from emoflow_ros.readers.dsec import DsecFolder, DsecRecording
from emoflow_ros.readers.mvsec import MvsecRecording
from emoflow_ros.truth import DsecFlow, PropagatedFlow, Truth
from emoflow_ros.truth.dsec_flow import DsecInterval, read_test_intervals
from emoflow_ros.truth.flow_maps import CroppedFlow, ListedFlow

WINDOWS = "windows"
DSEC = "dsec"
# Frames from the start to the end of an interval.
FRAME_STEPS = {"mvsec-dt1": 1, "mvsec-dt4": 4}
PROTOCOLS = (WINDOWS, *FRAME_STEPS, DSEC)
CAUSAL, PAPER = "causal", "paper"
POLICIES = (CAUSAL, PAPER)
_PUBLISHED_STEP = 4
_LEAD_IN = 4  # windows; a warm start has settled by then
# A causal window ends with its interval and reaches back before it. Beyond this displacement the
# change of the motion costs more accuracy than the further events gain.
_REACH_PX = 12.0
_IMAGE = "sensor_msgs/msg/Image"
_IMAGE_NAMES = ("image_raw", "image_mono")


@dataclass(frozen=True)
class Plan:
    """How a recording is evaluated.

    Attributes:
        slicer: cuts the windows.
        truth: what counts of the truth.
        description: protocol and policy in words, for the report.
        published: figures of the paper that may stand beside the result.
        images: the intervals that DSEC's benchmark asks flow images for.
    """

    slicer: Slicer
    truth: Truth
    description: str
    published: Published | None = None
    images: tuple[DsecInterval, ...] = ()


def adapt_windows(policy: WindowPolicy, protocol: str, clips: str) -> WindowPolicy:
    """Limit windows by motion to what a protocol's intervals can use.

    Clips of the published code are taken whole. Causal windows reach back from the end of their
    interval by 12 px at most, unless the interval itself is longer.
    """
    if protocol == WINDOWS:
        return policy
    most = 0.0 if clips == PAPER else min(policy.max_displacement_px, _REACH_PX)
    return replace(policy, max_displacement_px=most)


def make_plan(
    protocol: str,
    recording: Recording,
    truth: Truth,
    policy: WindowPolicy,
    sequence: BenchmarkSequence | None = None,
    *,
    clips: str = CAUSAL,
    test_times: Path | None = None,
) -> Plan:
    """Prepare a protocol.

    `windows` cuts the stream by `policy`. `mvsec-dt1` and `mvsec-dt4` estimate one window for
    every frame, up to the 1st and 4th frame after it, `dsec` one for every interval of the data
    set's flow images or of a test sequence's list.

    Args:
        protocol: one of PROTOCOLS.
        recording: opened.
        truth: of the recording.
        policy: of the windows (adapt_windows); intervals take their length from it.
        sequence: limits frames and rows.
        clips: one of POLICIES: windows that end with the intervals, or the published code's, with
            the flow truth of MVSEC's intervals by its rule (PropagatedFlow), too.
        test_times: DSEC's `<sequence>.csv`, or a folder that holds it.

    Raises:
        InputError: something unknown, or a recording without what the protocol counts in.
    """
    _check("--protocol", protocol, PROTOCOLS)
    _check("--policy", clips, POLICIES)
    if protocol == WINDOWS:
        plan = _free_windows(truth, policy, clips)
    elif protocol == DSEC:
        plan = _dsec(recording, truth, policy, sequence, clips, test_times)
    else:
        plan = _between_frames(protocol, recording, truth, policy, sequence, clips)
    return plan if sequence is None or sequence.rows is None else _cropped(plan, sequence.rows)


def _free_windows(truth: Truth, policy: WindowPolicy, clips: str) -> Plan:
    if clips == PAPER:
        raise InputError(
            "--policy paper",
            f"the protocol '{WINDOWS}' has no intervals to cut clips for",
            f"give --protocol {', '.join(PROTOCOLS[1:-1])} or {DSEC}",
        )
    if policy.count:
        words = f"windows of {policy.count} events"
    else:
        every = policy.stride_ns / NS_PER_MS
        words = f"windows of {policy.duration_ms:g} ms every {every:g} ms"
    return Plan(WindowSlicer(policy), truth, words + _by_motion(policy))


def _between_frames(
    protocol: str,
    recording: Recording,
    truth: Truth,
    policy: WindowPolicy,
    sequence: BenchmarkSequence | None,
    clips: str,
) -> Plan:
    step = FRAME_STEPS[protocol]
    stamps, source = _stamps(recording, truth)
    intervals = frame_intervals(stamps, step, sequence)
    of_sequence = f" of {sequence.name}" if sequence else ""
    if not intervals:
        raise InputError(
            recording.path,
            f"{len(stamps)} frames are too few for {protocol}{of_sequence}",
            "give the whole recording, or leave --sequence out",
        )
    words = f"{protocol}: from every {source} to number {step} after it, "
    words += f"{len(intervals)} intervals{of_sequence}"
    published = PUBLISHED.get(sequence.name) if sequence and step == _PUBLISHED_STEP else None
    if clips == PAPER:
        count = sequence.clip_events if sequence else MVSEC_CLIP
        if isinstance(truth.flows, PropagatedFlow):
            truth = replace(truth, flows=truth.flows.as_published())
        return Plan(ClipSlicer(intervals, count), truth, words + _clipped(count), published)
    slicer = CausalSlicer(intervals, policy.duration_ns)
    return Plan(slicer, truth, words + _causal(policy), published)


def _dsec(
    recording: Recording,
    truth: Truth,
    policy: WindowPolicy,
    sequence: BenchmarkSequence | None,
    clips: str,
    test_times: Path | None,
) -> Plan:
    images, source = _dsec_intervals(recording, truth, test_times)
    intervals = [(image.start, image.end) for image in images]
    truth = replace(truth, flows=truth.flows and ListedFlow(truth.flows, intervals))
    words = f"{DSEC}: {len(intervals)} intervals of {source}"
    published = PUBLISHED.get(sequence.name) if sequence else None
    if clips == PAPER:
        count = sequence.clip_events if sequence else DSEC_CLIP
        slicer: Slicer = ClipSlicer(intervals, count)
        return Plan(slicer, truth, words + _clipped(count), published, images)
    words += f"{_causal(policy)}; after a gap up to {_LEAD_IN} windows to warm up on"
    slicer = CausalSlicer(with_lead_in(intervals, _LEAD_IN), policy.duration_ns)
    return Plan(slicer, truth, words, published, images)


def _causal(policy: WindowPolicy) -> str:
    words = f"; policy causal: windows of {policy.duration_ms:g} ms that end with each"
    return f"{words}{_by_motion(policy)}, or its own events where it is longer"


def _by_motion(policy: WindowPolicy) -> str:
    most = policy.max_displacement_px
    return f", of each the latest {most:g} px" if most else ""


def _clipped(count: int) -> str:
    return f"; policy paper: {count} events around each, also from the future"


def _cropped(plan: Plan, rows: int) -> Plan:
    """Leave events and truth from row `rows` on out of a plan."""
    flows = plan.truth.flows
    return replace(
        plan,
        slicer=CroppedSlicer(plan.slicer, rows),
        truth=replace(plan.truth, flows=flows and CroppedFlow(flows, rows)),
        description=f"{plan.description}; rows from {rows} on are left out",
    )


def frame_intervals(
    stamps: NDArray[np.int64], step: int, sequence: BenchmarkSequence | None = None
) -> list[Interval]:
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


def _stamps(recording: Recording, truth: Truth) -> tuple[NDArray[np.int64], str]:
    """Frames of the recording; where it has none, the stamps of the true flow."""
    stamps = _frame_stamps(recording)
    if stamps is not None:
        return stamps, "frame"
    if isinstance(truth.flows, PropagatedFlow):
        return truth.flows.stamps, "ground-truth stamp (the recording has no frames)"
    raise InputError(
        recording.path,
        "no frames, which the MVSEC protocols count in",
        "give the original bag or HDF5 file, or the flow truth with --gt",
    )


def _dsec_intervals(
    recording: Recording, truth: Truth, test_times: Path | None
) -> tuple[tuple[DsecInterval, ...], str]:
    """Take the intervals of a list that was given, of the truth, or of the folder's list."""
    if not isinstance(recording, DsecRecording) or not recording.rectified:
        raise InputError(
            recording.path,
            f"the protocol '{DSEC}' counts pixels of the rectified view",
            "give the folder of a DSEC sequence, without --calib",
        )
    if test_times is None and isinstance(truth.flows, DsecFlow):
        return tuple(truth.flows.intervals), "the flow truth"
    if test_times is not None and test_times.is_dir():
        test_times = test_times / f"{recording.path.resolve().name}.csv"
    path = test_times or DsecFolder(recording.path).test_times
    if path is None:
        raise InputError(
            recording.path,
            "neither flow truth (flow/forward) nor the benchmark's list of intervals",
            "unpack the flow truth there, or give the list with --timestamps",
        )
    return tuple(read_test_intervals(path)), path.name


def _check(option: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError(option, f"unknown value '{value}'", f"use one of {', '.join(known)}")


def _frame_stamps(recording: Recording) -> NDArray[np.int64] | None:
    """Times (N,) in ns of the frames beside the events; None where the recording has none."""
    if isinstance(recording, BagRecording):
        return _bag_stamps(recording.path, recording.topic.rpartition("/")[0])
    if isinstance(recording, MvsecRecording):
        with h5py.File(recording.path) as file:
            name = recording.topic.rpartition("/")[0] + "/image_raw_ts"
            if name in file:
                return np.rint(file[name][:] * NS_PER_S).astype(np.int64)
    return None


def _bag_stamps(path: Path, namespace: str) -> NDArray[np.int64] | None:
    with open_bag(path) as bag:
        names = [f"{namespace}/{name}" for name in _IMAGE_NAMES]
        images = [c for c in bag.connections if c.msgtype == _IMAGE and c.topic in names]
        if not images:
            return None
        headers = (
            deserialize(bag, connection, data).header.stamp
            for connection, _, data in read_messages(path, bag, images[:1])
        )
        return np.array([s.sec * NS_PER_S + s.nanosec for s in headers], np.int64)
