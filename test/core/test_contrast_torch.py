"""The contrast on devices against the one on the processor, which has its own references."""

import pickle
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from emoflow_ros.core import kernels
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import load_config
from emoflow_ros.core.contrast import Contrast, best_constant_flow, contrast_gain
from emoflow_ros.core.contrast_torch import TorchContrast
from emoflow_ros.core.estimate import Status
from emoflow_ros.core.events import WindowPolicy, WindowSlicer
from emoflow_ros.core.factory import make_estimator
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.lattice_estimator import LatticeEstimator
from emoflow_ros.core.window_events import WindowEvents
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.recording import simulate

CAPACITY = 4000
NO_CUDA = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
SCALES = (0.25, 0.5, 1.0)


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=NO_CUDA)])
def device(request) -> str:
    return request.param


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def lattice() -> Lattice:
    return Lattice(120, 90, 5, 4)


def moving_dots(rng, count: int = 3000, size=(120, 90)) -> WindowEvents:
    """Dots of either polarity; on all corners, at the first and at the last moment, too."""
    dot = rng.integers(0, 60, count)
    s = np.sort(rng.random(count, np.float32))
    at = rng.uniform((0, 0), size, (60, 2))[dot] + s[:, None] * (8, -5)
    x, y = np.clip(np.rint(at + rng.normal(scale=0.3, size=at.shape)), 0, np.array(size) - 1).T
    x[:4], y[:4], s[:4] = [0, 119, 0, 119], [0, 0, 89, 89], [0, 1, 1, 0]
    return WindowEvents.prepare(x.astype(np.float32), y.astype(np.float32), s, dot % 2 == 0)


def random_flow(rng, shape, scale: float = 4.0):
    return rng.normal(scale=scale, size=shape).astype(np.float32)


def assert_alike(contrast, reference, events, flow, ref: float = 0.5):
    """Float32 sums in another order: 1e-6 of the largest entries; 1e-5 is asked for."""
    cells = contrast.linearise(events, flow, ref)
    for mine, its in zip(cells, reference.linearise(events, flow, ref), strict=True):
        assert np.abs(its).max() > 0.01
        np.testing.assert_allclose(mine, its, atol=1e-5 * np.abs(its).max())


@pytest.mark.parametrize("scale", SCALES)
def test_linearised_as_on_the_processor(rng, device, scale):
    grid = lattice()
    contrast = TorchContrast(grid, scale, device=device, capacity=CAPACITY)
    events, flow = moving_dots(rng), random_flow(rng, grid.shape)
    assert_alike(contrast, Contrast(grid, scale), events, flow)


def test_steps_and_windows_follow_each_other(rng, device):
    """Nothing of a field or of a longer window before is left in the buffers."""
    grid = lattice()
    contrast = TorchContrast(grid, 1.0, device=device, capacity=CAPACITY)
    reference = Contrast(grid, 1.0)
    for count in (CAPACITY, 700, 2000):
        events = moving_dots(rng, count)
        for _ in range(2):
            assert_alike(contrast, reference, events, random_flow(rng, grid.shape))


def test_the_same_events_warped_to_one_time_after_another(rng, device):
    grid = lattice()
    contrast = TorchContrast(grid, 0.25, device=device, capacity=CAPACITY)
    events, flow = moving_dots(rng), random_flow(rng, grid.shape)
    for ref in (0.5, 1 / 6, 5 / 6):
        assert_alike(contrast, Contrast(grid, 0.25), events, flow, ref)


def test_events_of_one_cell_and_events_that_leave_the_image(rng, device):
    grid = lattice()
    events = moving_dots(rng, CAPACITY, (25, 25))
    contrast = TorchContrast(grid, 1.0, device=device, capacity=CAPACITY)
    flow = random_flow(rng, grid.shape, scale=200.0)
    position = np.empty((2, len(events)), np.float32)
    kernels.warp(events.on(grid), 0.5, flow, grid.acceleration(flow), position)
    assert (position < -12).any(axis=0).sum() > 100
    assert_alike(contrast, Contrast(grid, 1.0), events, flow)


class Recorder(TorchDispatchMode):
    """Notes which operations torch is asked for, and the bytes of those that copy."""

    def __init__(self):
        super().__init__()
        self.names: list[str] = []
        self.copied: list[int] = []

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        self.names.append(function.overloadpacket.__name__)
        if self.names[-1] == "copy_":
            self.copied.append(args[0].numel() * args[0].element_size())
        return function(*args, **(kwargs or {}))


def test_a_step_copies_the_field_and_the_cells_and_asks_the_device_for_nothing_else(rng):
    """Operations whose result the host must know would end a capture, and wait."""
    grid = lattice()
    contrast = TorchContrast(grid, 1.0, device="cpu", capacity=CAPACITY)
    events = moving_dots(rng)
    with Recorder() as loading:
        contrast.sharpen(events, random_flow(rng, grid.shape))
    with Recorder() as step:
        contrast.linearise(events, random_flow(rng, grid.shape))
    nodes, cells = 5 * 4 * 2, 4 * 3
    assert step.copied == [4 * nodes * 4, 4 * cells * (2 * 8 + 27 * 3)]
    waiting = {"_local_scalar_dense", "nonzero", "masked_select", "unique_dim", "bincount"}
    assert not waiting & set(step.names)
    assert [name for name in loading.names if name in waiting] == ["_local_scalar_dense"]


@pytest.mark.parametrize("scale", SCALES)
def test_scores_and_gain_as_on_the_processor(rng, device, scale):
    grid = lattice()
    contrast = TorchContrast(grid, scale, device=device, capacity=CAPACITY)
    reference = Contrast(grid, scale)
    events, flow = moving_dots(rng), random_flow(rng, grid.shape, scale=1.0)
    flows = np.array([(0.0, 0.0), (7.5, -4.25), (-150.0, 90.0)], np.float32)
    np.testing.assert_allclose(
        contrast.scores(events, flows), reference.scores(events, flows), rtol=1e-5
    )
    assert contrast_gain(contrast, events, flow) == pytest.approx(
        contrast_gain(reference, events, flow), rel=1e-5
    )


def test_the_search_of_a_constant_flow_finds_the_same(rng, device):
    grid = lattice()
    events = moving_dots(rng)
    contrast = TorchContrast(grid, 0.25, device=device, capacity=CAPACITY)
    found = best_constant_flow(contrast, events, 24.0)
    np.testing.assert_array_equal(found, best_constant_flow(Contrast(grid, 0.25), events, 24.0))


def test_more_events_than_there_is_room_for_are_refused(rng):
    contrast = TorchContrast(lattice(), 1.0, device="cpu", capacity=1000)
    with pytest.raises(ValueError, match="1001 events in buffers for 1000"):
        contrast.sharpen(moving_dots(rng, 1001), random_flow(rng, lattice().shape))


def test_a_saved_contrast_goes_on_as_before(rng, device):
    contrast = TorchContrast(lattice(), 0.5, device=device, capacity=CAPACITY)
    events, flow = moving_dots(rng), random_flow(rng, lattice().shape)
    contrast.sharpen(events, flow)
    saved = pickle.dumps(contrast)
    assert len(saved) < 2000  # without its buffers
    assert_alike(pickle.loads(saved), Contrast(lattice(), 0.5), events, flow)


def test_whole_estimates_are_those_of_the_processor(device):
    """A cold window and two warm ones. Rounding moves single events over the borders of pixels,
    which the steps pass on; the estimate's own errors are far larger. In none of the windows the
    claim of v hangs on that: in the third window of seed 1 it does.
    """
    recording = simulate("calm", duration_s=0.3, seed=5, fps=500)
    windows = WindowSlicer(WindowPolicy(duration_ms=90.0)).push(recording.events)
    assert len(windows) == 3
    config = LatticeConfig(max_events=15_000)
    make_contrast = partial(TorchContrast, device=device, capacity=config.max_events)
    ours = LatticeEstimator(recording.camera, config, make_contrast)
    reference = LatticeEstimator(recording.camera, config)
    for window in windows:
        mine, its = ours.estimate(window), reference.estimate(window)
        assert mine.status is its.status is Status.OK
        assert mine.model is its.model
        apart = [e.flow.displacement(window.t_start, window.t_end) for e in (mine, its)]
        assert np.sqrt(np.mean((apart[0] - apart[1]) ** 2)) < 0.02  # px
        sigma, expected = (np.sqrt(np.diag(e.covariance)) for e in (mine, its))
        np.testing.assert_allclose(sigma, expected, rtol=0.2)
        np.testing.assert_allclose(mine.linear, its.linear, atol=1e-2)
        assert (np.abs(mine.angular - its.angular) < 0.1 * sigma[3:]).all()


@NO_CUDA
def test_the_configured_device_is_taken():
    config = load_config(overrides={"estimator.device": "cuda"})
    recording = simulate("calm", duration_s=0.1, seed=1, fps=500)
    (window,) = WindowSlicer(WindowPolicy(duration_ms=90.0)).push(recording.events)
    assert make_estimator(recording.camera, config).estimate(window).status is Status.OK


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is here")
@pytest.mark.parametrize("profile", ["realtime", "paper"])
def test_a_missing_device_is_refused_in_one_line(profile):
    config = load_config(profile, {"estimator.device": "cuda"})
    camera = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)
    message = r"^estimator\.device: no CUDA device was found; use cpu, or check the driver$"
    with pytest.raises(InputError, match=message):
        make_estimator(camera, config)


def test_the_estimator_on_the_processor_loads_no_torch():
    code = (
        "import sys; from emoflow_ros.core.factory import *; from emoflow_ros.core.config import *;"
        "make_estimator(Camera(346, 260, 226.0, 226.0, 173.0, 130.0), Config());"
        "print('torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
