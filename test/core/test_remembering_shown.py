"""Flows of earlier windows that the memory keeps: few of them, and none does harm later."""

import numpy as np
import pytest

from emoflow_ros.config import load_config
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.remembering import RememberingEstimator
from emoflow_ros.core.types.estimate import Status
from emoflow_ros.core.types.events import Window, WindowSlicer
from emoflow_ros.simulation.recording import simulate

CONFIG = load_config("realtime")


def reader_and_windows(seconds: float) -> tuple[RememberingEstimator, list[Window]]:
    recording = simulate("calm", duration_s=seconds, seed=4, fps=500)
    lattice = LatticeEstimator(recording.camera, CONFIG.estimator)
    reader = RememberingEstimator(lattice, recording.camera, lattice.refined)
    return reader, list(WindowSlicer(CONFIG.window).push(recording.events))


def test_flows_are_kept_up_to_a_number():
    reader, windows = reader_and_windows(1.6)
    kept = []
    for window in windows:
        estimate = reader.estimate(window)
        assert estimate.flow is not None
        kept.append([flow.t for flow in reader._memory.shown])
    assert len(windows) > 18
    assert [len(times) for times in kept][-3:] == [16] * 3
    assert kept[-1][-1] == (estimate.t_start + estimate.t_end) // 2
    assert (np.diff(kept[-1]) > 0).all()
    reader.reset()
    assert reader._memory.shown == ()


def test_an_adjustment_that_diverges_leaves_the_lattice_s_estimate(monkeypatch: pytest.MonkeyPatch):
    reader, windows = reader_and_windows(0.8)
    for window in windows[:5]:
        reader.estimate(window)
    assert len(reader._memory.shown) >= 2
    with monkeypatch.context() as patched:
        patched.setattr("emoflow_ros.core.odometry.best", lambda *_: None)
        estimate = reader.estimate(windows[5])
    assert estimate.status is Status.OK and estimate.flow is not None
    assert len(reader._memory.odometry.t) == 0
    for window in windows[6:]:
        again = reader.estimate(window)
    assert again.status is Status.OK and again.flow is not None
    assert len(reader._memory.odometry.t) >= 3


def test_a_first_window_has_slices_enough_for_a_motion():
    """Three nodes at least are adjusted; later windows are cut into two slices at most."""
    reader, windows = reader_and_windows(0.4)
    reader.estimate(windows[0])
    first = reader._memory.odometry
    assert len(first.t) in (3, 4)
    assert first.adjusted is not None
    reader.estimate(windows[1])
    assert 0 < len(set(reader._memory.odometry.t) - set(first.t)) <= 2
