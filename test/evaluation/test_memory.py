"""Memory of a long run: it grows by a window's figures and by nothing of its events."""

import pickle
import tracemalloc
from pathlib import Path

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS, Events, WindowPolicy, WindowSlicer
from emoflow_ros.evaluation.estimates_file import EstimatesWriter, read_estimates
from emoflow_ros.evaluation.run_progress import Progress
from emoflow_ros.evaluation.window_run import proceed
from emoflow_ros.truth import Truth
from emoflow_ros.truth.ground_truth import PoseTrack
from emoflow_ros.truth.text_truth import ConstantRotation

CAMERA = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
RATE = np.array([0.1, -0.2, 0.05])
WINDOW_MS, EVENTS_PER_WINDOW, CHUNK_MS = 10, 1000, 25
SETTLED, WINDOWS = 50, 200
EVENTS_BYTES = EVENTS_PER_WINDOW * (2 + 2 + 8 + 1)
MOST_BYTES_PER_WINDOW = 4096


class Generated:
    """A recording that is made up while it is read, and watches the memory."""

    path, topic, camera, check = Path("generated"), "", CAMERA, None

    def __init__(self, windows):
        self.duration = windows * WINDOW_MS / 1e3
        self.bytes_at = {}

    def event_chunks(self, since=None):
        rng = np.random.default_rng(0)
        n = EVENTS_PER_WINDOW * CHUNK_MS // WINDOW_MS
        for k in range(round(self.duration * 1e3) // CHUNK_MS):
            self.bytes_at[k * CHUNK_MS // WINDOW_MS] = tracemalloc.get_traced_memory()[0]
            offsets = np.sort(rng.integers(0, CHUNK_MS * NS_PER_MS, n))
            yield Events(
                rng.integers(0, CAMERA.width, n).astype(np.uint16),
                rng.integers(0, CAMERA.height, n).astype(np.uint16),
                10**9 + k * CHUNK_MS * NS_PER_MS + offsets,
                rng.integers(0, 2, n).astype(np.bool_),
            )


class Constant:
    """Always the true rotation, with a flow on a real lattice."""

    def __init__(self):
        self.lattice = Lattice.with_spacing(CAMERA.width, CAMERA.height, 16)

    def estimate(self, window):
        values = np.full(self.lattice.shape, 0.5, np.float32)
        return Estimate(
            window.t_start,
            window.t_end,
            (window.t_start + window.t_end) // 2,
            Status.OK,
            Quality(events=len(window.events), runtime_s=1e-3, contrast_gain=1.2),
            MotionModel.ROTATION,
            angular=RATE,
            flow=LatticeFlow(self.lattice, values, window.t_start, window.t_end),
        )

    def reset(self):
        pass


def test_memory_grows_by_the_figures_alone(tmp_path):
    rotation = ConstantRotation(CAMERA, RATE, "test")
    track = PoseTrack(np.array([0, 10**12]), np.zeros((2, 3)), np.tile([0, 0, 0, 1.0], (2, 1)))
    truth = Truth(rotation, rotation, (rotation,), track)
    recording = Generated(WINDOWS)
    progress = Progress(Constant(), WindowSlicer(WindowPolicy(duration_ms=WINDOW_MS)))
    tracemalloc.start()
    try:
        with EstimatesWriter(
            tmp_path / "e.h5", camera=CAMERA, source="", configuration={}
        ) as writer:
            run = proceed(recording, progress, truth, writer=writer)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()

    assert len(run.windows) == len(read_estimates(tmp_path / "e.h5")) >= WINDOWS - 1
    assert all(w.flow is not None and w.pose is not None for w in run.windows)
    at = sorted(k for k in recording.bytes_at if k >= SETTLED)
    growth = (recording.bytes_at[at[-1]] - recording.bytes_at[at[0]]) / (at[-1] - at[0])
    assert growth < MOST_BYTES_PER_WINDOW < EVENTS_BYTES / 3
    # All at once: the figures, the few windows of the gallery, and what is being worked on.
    assert peak < WINDOWS * MOST_BYTES_PER_WINDOW + 200 * EVENTS_BYTES
    assert len(pickle.dumps(progress)) < WINDOWS * MOST_BYTES_PER_WINDOW + 100 * EVENTS_BYTES
