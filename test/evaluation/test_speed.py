"""Speed of a whole evaluation, with a bound that a slow and busy machine keeps, too."""

import time

import pytest

from benchmarks.offline import figures, row, table
from emoflow_ros.config import load_config
from emoflow_ros.core.types.events import WindowSlicer
from emoflow_ros.evaluation.estimates_file import EstimatesWriter
from emoflow_ros.evaluation.window_run import evaluate
from emoflow_ros.factory import make_estimator
from emoflow_ros.readers import open_recording
from emoflow_ros.simulation.recording import davis346, simulate
from emoflow_ros.simulation.recording_files import OutputPaths, write_recording
from emoflow_ros.truth import load_truth

SECONDS = 2.0
MOST_PROCESSOR_SECONDS = 4 * SECONDS  # one core without company takes about real time


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> OutputPaths:
    """Two seconds in MVSEC's format."""
    simulated = simulate(
        "calm", duration_s=SECONDS, seed=2, camera=davis346("equidistant"), fps=150
    )
    files = OutputPaths.within(tmp_path_factory.mktemp("mvsec"), "calm", "rosbag1")
    write_recording(simulated, files, "rosbag1")
    return files


def test_evaluation_keeps_up_with_the_recording(recording, tmp_path):
    """Reading, estimating, comparing with poses and flow, and writing, in processor time."""
    config = load_config("realtime")
    with open_recording(recording.data, calibration=recording.calibration) as opened:
        truth = load_truth(opened, [recording.truth, recording.flow])
        estimator = make_estimator(opened.camera, config)
        evaluate(opened, estimator, WindowSlicer(config.window), truth, max_windows=2)  # compiled
        with EstimatesWriter(
            tmp_path / "e.h5", camera=opened.camera, source="", configuration={}
        ) as writer:
            began = time.process_time()
            run = evaluate(opened, estimator, WindowSlicer(config.window), truth, writer=writer)
            spent = time.process_time() - began
    assert len(run.windows) == 28
    assert all(w.ok and w.truth for w in run.windows)
    assert all(w.flow for w in run.windows[:-1])  # the last one ends after the truth's stamps
    assert spent < MOST_PROCESSOR_SECONDS
    assert run.wall_s > sum(w.quality.runtime_s for w in run.windows) > 0


def test_benchmark_splits_the_time():
    """Ten windows of 0.1 s in 5 ms each; the run took 0.2 s of the process's 0.5 s."""
    summary = {"real_time_factor": {"value": 20.0}, "epe_px": {"value": 0.5}}
    done = {
        "windows": [{"runtime_s": 0.005}] * 10,
        "windows_total": 10,
        "windows_ok": 9,
        "events": 1000,
        "recorded_s": 1.0,
        "wall_s": 0.2,
        "wall_real_time_factor": 5.0,
        "summary": summary,
    }
    found = figures(done, wall_s=0.5, cpu_s=0.45)
    parts = found["parts_s"]
    assert list(parts.values()) == pytest.approx([0.05, 0.15, 0.3])
    assert found["real_time_factor"] == pytest.approx(2.0)
    facts = {
        "scene": "calm",
        "megabytes": 10.0,
        "machine": {"processor": "some"},
        "cores_used": 2,
        "load_average_at_start": 0.0,
        "versions": {"emoflow_ros": "1"},
    }
    assert ">= 3         2  missed" in table(facts | found)
    assert row(found | {"real_time_factor": 3.1}).verdict == "met"
