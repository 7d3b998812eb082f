"""The benchmarks' intervals, counted by hand."""

import h5py
import numpy as np
import pytest

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.benchmark_sequences import (
    PUBLISHED,
    SEQUENCES,
    BenchmarkSequence,
    find_sequence,
)
from emoflow_ros.evaluation.protocols import adapt_windows, frame_intervals, make_plan
from emoflow_ros.evaluation.slicers import CroppedSlicer
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import TrueFlow, Truth
from emoflow_ros.truth.flow_maps import CroppedFlow

INDOOR = SEQUENCES["indoor_flying1"].camera


def test_every_frame_starts_an_interval():
    stamps = np.array([10, 20, 30, 45, 60])
    assert frame_intervals(stamps, 1) == [(10, 20), (20, 30), (30, 45), (45, 60)]
    assert frame_intervals(stamps, 4) == [(10, 60)]
    assert frame_intervals(stamps, 5) == []


def test_first_and_last_frame_of_a_sequence():
    stamps = np.arange(8) * 10
    some = BenchmarkSequence("some", INDOOR, first_frame=2, last_frame=4)
    assert frame_intervals(stamps, 1, some) == [(20, 30), (30, 40), (40, 50)]
    assert frame_intervals(stamps, 4, some) == [(20, 60), (30, 70)]


def test_segment_holds_whole_intervals():
    stamps = np.arange(6) * NS_PER_S
    some = BenchmarkSequence("some", INDOOR, segment_s=(1.0, 4.0))
    seconds = [(a // NS_PER_S, b // NS_PER_S) for a, b in frame_intervals(stamps, 2, some)]
    assert seconds == [(1, 3), (2, 4)]


@pytest.mark.parametrize(
    ("name", "first", "last", "rows", "clip"),
    [
        ("indoor_flying1", 60, 1340, None, 30_000),
        ("indoor_flying2", 140, 1500, None, 30_000),
        ("indoor_flying3", 100, 1711, None, 30_000),
        ("indoor_flying4", 104, 380, None, 30_000),
        ("outdoor_day1", 0, 5020, 193, 40_000),
        ("outdoor_day2", 0, 5020, 193, 40_000),
    ],
)
def test_published_frame_ranges(name, first, last, rows, clip):
    sequence = find_sequence(name)
    assert (sequence.first_frame, sequence.last_frame, sequence.rows) == (first, last, rows)
    assert sequence.clip_events == clip
    assert sequence.camera.model == "equidistant"


def test_windows_by_motion_are_named(mvsec_file):
    policy = WindowPolicy(stride_ms=30.0, max_displacement_px=16.0)
    with open_recording(mvsec_file) as recording:
        free = make_plan("windows", recording, Truth(), policy)
        between = make_plan("mvsec-dt1", recording, Truth(), policy)
    assert free.description == "windows of 90 ms every 30 ms, of each the latest 16 px"
    words = (
        "policy causal: windows of 90 ms that end with each, of each the latest 16 px, or its own"
    )
    assert words in between.description


@pytest.mark.parametrize(
    ("protocol", "clips", "bound", "adapted"),
    [
        ("windows", "causal", 32.0, 32.0),
        ("mvsec-dt1", "causal", 32.0, 12.0),
        ("dsec", "causal", 8.0, 8.0),
        ("mvsec-dt4", "causal", 0.0, 0.0),
        ("mvsec-dt4", "paper", 32.0, 0.0),
    ],
)
def test_windows_by_motion_reach_back_less_far_from_intervals(protocol, clips, bound, adapted):
    policy = WindowPolicy(duration_ms=135.0, max_displacement_px=bound)
    expected = WindowPolicy(duration_ms=135.0, max_displacement_px=adapted)
    assert adapt_windows(policy, protocol, clips) == expected


def test_published_figures_stand_beside_dt4_only(mvsec_file):
    sequence = BenchmarkSequence("indoor_flying1", INDOOR)
    with open_recording(mvsec_file) as recording:
        plans = [
            make_plan(protocol, recording, Truth(), WindowPolicy(), sequence)
            for protocol in ("windows", "mvsec-dt1", "mvsec-dt4")
        ]
    assert [plan.published for plan in plans] == [None, None, PUBLISHED["indoor_flying1"]]
    figures = {
        "epe_px": 1.56,
        "paper_angular_rms_deg_s": 3.44,
        "paper_linear_rms_m_s": 0.11,
        "runtime_p50_ms": 9300,
    }
    assert plans[2].published.figures == figures
    assert PUBLISHED.keys() < SEQUENCES.keys()


def test_unknown_sequence_lists_the_known_ones():
    with pytest.raises(InputError, match="use one of indoor_flying1, indoor_flying2"):
        find_sequence("indoor_flying9")


class FullFlow:
    description = "flow: test"

    def displacement(self, t0, t1):
        return TrueFlow(np.ones((4, 3, 2), np.float32), np.ones((4, 3), bool))


def test_crop_keeps_the_rows_above():
    valid = CroppedFlow(FullFlow(), 3).displacement(0, 1).valid
    np.testing.assert_array_equal(valid, [[True] * 3] * 3 + [[False] * 3])


@pytest.fixture
def mvsec_file(tmp_path):
    """10 frames at 20 Hz, events at 1 kHz."""
    path = tmp_path / "x_data.hdf5"
    n = 500
    t = 100 + np.arange(n) * 1e-3
    with h5py.File(path, "w") as file:
        file["davis/left/events"] = np.column_stack([np.arange(n) % 346, np.arange(n) % 260, t, t])
        file["davis/left/image_raw_ts"] = 100 + np.arange(10) * 0.05
    return path


def test_mvsec_plan_from_hdf5_frames(mvsec_file):
    with open_recording(mvsec_file) as recording:
        plan = make_plan("mvsec-dt4", recording, Truth(), WindowPolicy())
        events = Events.concatenate(list(recording.event_chunks()))
    windows = plan.slicer.push(events)
    start = 100 * NS_PER_S
    assert [(w.t_start - start) // NS_PER_MS for w in windows] == [0, 50, 100, 150, 200, 250]
    assert all(w.t_end - w.t_start == 200 * NS_PER_MS for w in windows)
    assert "every frame to number 4 after it, 6 intervals" in plan.description


def test_short_intervals_get_windows_of_the_configured_length(mvsec_file):
    """From one frame to the next are 50 ms: with 120 ms the window reaches back, not forward."""
    with open_recording(mvsec_file) as recording:
        plan = make_plan("mvsec-dt1", recording, Truth(), WindowPolicy(duration_ms=120.0))
        events = Events.concatenate(list(recording.event_chunks()))
    start = 100 * NS_PER_S
    windows = plan.slicer.push(events)
    spans = [((w.t_start - start) // NS_PER_MS, (w.t_end - start) // NS_PER_MS) for w in windows]
    assert spans[:4] == [(0, 50), (0, 100), (30, 150), (80, 200)]
    compared = [(w.compared.t_start - start) // NS_PER_MS for w in windows]
    assert compared == [0, 50, 100, 150, 200, 250, 300, 350, 400]


def test_mvsec_plan_of_too_short_a_recording(mvsec_file):
    with open_recording(mvsec_file) as recording, pytest.raises(InputError, match="10 frames"):
        make_plan("mvsec-dt1", recording, Truth(), WindowPolicy(), find_sequence("indoor_flying1"))


def test_protocol_without_frames(tmp_path):
    folder = tmp_path / "e"
    folder.mkdir()
    (folder / "events.txt").write_text("0.1 1 1 1\n")
    with open_recording(folder) as recording, pytest.raises(InputError, match="no frames"):
        make_plan("mvsec-dt1", recording, Truth(), WindowPolicy())


def test_windows_plan(tmp_path, mvsec_file):
    with open_recording(mvsec_file) as recording:
        policy = WindowPolicy(duration_ms=50.0, stride_ms=25.0)
        plan = make_plan("windows", recording, Truth(flows=FullFlow()), policy)
        cropped = make_plan(
            "windows", recording, Truth(flows=FullFlow()), policy, find_sequence("outdoor_day1")
        )
    assert isinstance(plan.slicer, WindowSlicer)
    assert plan.description == "windows of 50 ms every 25 ms"
    assert cropped.description.endswith("; rows from 193 on are left out")
    assert isinstance(cropped.truth.flows, CroppedFlow)
    assert isinstance(cropped.slicer, CroppedSlicer)
