"""A run that is stopped and continued equals one that was not."""

import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import WindowPolicy, WindowSlicer
from emoflow_ros.errors import InputError
from emoflow_ros.evaluation.estimates_file import EstimatesWriter, read_estimates
from emoflow_ros.evaluation.run_progress import Checkpoint, Progress
from emoflow_ros.evaluation.window_run import proceed
from emoflow_ros.readers import open_recording
from emoflow_ros.truth import Truth

CAMERA = Camera(240, 180, 20.0, 20.0, 16.0, 12.0)


class Remembering:
    """Its answer depends on every window before."""

    stop_at = None

    def __init__(self):
        self.memory = 0.0

    def estimate(self, window):
        if window.t_start == self.stop_at:
            raise KeyboardInterrupt
        self.memory = 0.9 * self.memory + float(window.events.x.sum())
        return Estimate(
            window.t_start,
            window.t_end,
            window.t_start,
            Status.OK,
            Quality(events=len(window.events)),
            MotionModel.ROTATION,
            angular=np.array([self.memory, 0, 0]),
        )

    def reset(self):
        self.memory = 0.0


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "e"
    path.mkdir()
    rng = np.random.default_rng(0)
    lines = [f"{1 + k * 1e-3:.6f} {rng.integers(240)} 5 1" for k in range(1000)]
    (path / "events.txt").write_text("\n".join(lines) + "\n")
    (path / "calib.txt").write_text("20 20 16 12 0 0 0 0 0")
    return path


def run(folder, out, progress, checkpoint=None, keep=0):
    with (
        open_recording(folder) as recording,
        EstimatesWriter(out, camera=CAMERA, source="", configuration={}, keep=keep) as writer,
    ):
        return proceed(recording, progress, Truth(), writer=writer, checkpoint=checkpoint)


def new_progress():
    policy = WindowPolicy(duration_ms=50.0, stride_ms=20.0)
    return Progress(Remembering(), WindowSlicer(policy))


@pytest.mark.parametrize("period", [0.0, 1e9])
@pytest.mark.parametrize("chunk_bytes", [400, 1 << 20])
def test_continued_run_equals_an_uninterrupted_one(
    folder, tmp_path, monkeypatch, period, chunk_bytes
):
    """Whether every window was saved, or only a few at the start: nothing lost, nothing twice."""
    monkeypatch.setattr("emoflow_ros.readers.ecd._CHUNK_BYTES", chunk_bytes)
    run(folder, tmp_path / "whole.h5", new_progress())
    whole = read_estimates(tmp_path / "whole.h5").columns
    assert len(whole["t"]) == 48

    monkeypatch.setattr("emoflow_ros.evaluation.run_progress.PERIOD_S", period)
    checkpoint = Checkpoint(tmp_path / "c.pickle", {"input": "e"})
    progress = new_progress()
    if period:  # saved once, after nothing was done
        checkpoint.save(progress)
    monkeypatch.setattr(Remembering, "stop_at", 1_000_000_000 + 30 * 20_000_000)
    first = run(folder, tmp_path / "parts.h5", progress, checkpoint)
    assert first.interrupted
    assert len(first.windows) == 30

    monkeypatch.setattr(Remembering, "stop_at", None)
    saved = checkpoint.load()
    assert len(saved.windows) == (0 if period else 30)
    second = run(folder, tmp_path / "parts.h5", saved, checkpoint, keep=len(saved.windows))
    assert not second.interrupted
    assert [w.index for w in second.windows] == list(range(48))
    parts = read_estimates(tmp_path / "parts.h5").columns
    for name in ("t_start_ns", "t_end_ns", "angular", "events"):
        np.testing.assert_array_equal(parts[name], whole[name])
    assert checkpoint.load() is None  # a finished run leaves none


def test_rows_are_on_disk_when_a_checkpoint_is_saved(folder, tmp_path, monkeypatch):
    """Else a run that is killed right afterwards could not be continued."""
    monkeypatch.setattr("emoflow_ros.evaluation.run_progress.PERIOD_S", 0.0)
    monkeypatch.setattr("emoflow_ros.evaluation.estimates_file._PERIOD_S", 1e9)
    rows = []

    class Watched(Checkpoint):
        def save(self, progress):
            super().save(progress)
            copy = tmp_path / "copy.h5"
            copy.write_bytes((tmp_path / "e.h5").read_bytes())
            rows.append((len(read_estimates(copy)), len(progress.windows)))

    run(folder, tmp_path / "e.h5", new_progress(), Watched(tmp_path / "c.pickle", {}))
    assert rows == [(n, n) for n in range(1, 49)]


def test_checkpoint_of_another_run_is_refused(tmp_path):
    path = tmp_path / "c.pickle"
    Checkpoint(path, {"input": "a", "configuration": {"x": 1}}).save(new_progress())
    other = Checkpoint(path, {"input": "a", "configuration": {"x": 2}})
    with pytest.raises(InputError, match="of a run with another configuration; leave --resume"):
        other.load()


def test_damaged_checkpoint(tmp_path):
    path = tmp_path / "c.pickle"
    checkpoint = Checkpoint(path, {})
    checkpoint.save(new_progress())
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match="damaged checkpoint"):
        checkpoint.load()


def test_estimates_that_lost_rows(folder, tmp_path):
    run(folder, tmp_path / "e.h5", new_progress())
    with pytest.raises(InputError, match="fewer than 99 rows"):
        EstimatesWriter(tmp_path / "e.h5", camera=CAMERA, source="", configuration={}, keep=99)
