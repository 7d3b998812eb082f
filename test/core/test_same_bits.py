"""Several kernels in one compiled call compute the same bits as one by one, in every process."""

import os
import subprocess
import sys

SCRIPT = """
import numpy as np
from emoflow_ros.core import derivatives, kernels
from emoflow_ros.core.camera import Camera
from emoflow_ros.core.config import load_config
from emoflow_ros.core.contrast import STIFFNESS_STRIDE, TAPS, Contrast
from emoflow_ros.core.events import Events, Window
from emoflow_ros.core.factory import make_estimator
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.smoothing import outwards, smooth
from emoflow_ros.core.window_events import PARTS, WindowEvents

rng = np.random.default_rng(0)
camera = Camera(346, 260, 200.0, 200.0, 173.0, 130.0)
estimator, size, length = make_estimator(camera, load_config("realtime")), 30_000, 90_000_000
dots = rng.uniform((9, 2), (346, 260), (2000, 2))
for k in range(2):
    of, t = rng.integers(0, 2000, size), np.sort(rng.integers(0, length, size))
    x, y = (dots[of] - np.outer(t / length, (9, 2))).astype(np.uint16).T
    events = Events(x.copy(), y.copy(), t + k * length, of % 2 == 0)
    assert estimator.estimate(Window(k * length, (k + 1) * length, events)).status == "ok"

lattice = Lattice.with_spacing(240, 180, 26.0)
x, y, s = rng.random((3, size)).astype(np.float32)
events = WindowEvents(239 * x, 179 * y, np.sort(s), np.float32(rng.normal(size=size)))
flow = np.float32(rng.normal(scale=5, size=lattice.shape))
contrast = Contrast(lattice, 0.5)
contrast.sharpen(events, flow)
cells = contrast.linearise(events, flow)

here, position = events.on(lattice), np.empty((2, len(events)), np.float32)
images, by_hand = np.empty_like(contrast._parts), [np.empty_like(part) for part in cells]
kernels.warp(here, 0.5, flow, lattice.acceleration(flow), position)
kernels.vote(position, here.weights, here.part, contrast._zoom, images)
smooth(images, outwards(np.convolve(TAPS, TAPS)))
kernels.without_own(images)
drawn, pairs = (here, 0.5, position, images, contrast._zoom), PARTS / (PARTS - 1)
slope = contrast._zoom**2 * pairs
derivatives.pull(*drawn, slope, by_hand[0])
derivatives.stiffen(*drawn, STIFFNESS_STRIDE, slope * pairs, by_hand[1])
pairs = (*zip(cells, by_hand), (contrast._parts, images))
print(*(np.array_equal(a, b) for a, b in pairs))
"""


def test_the_process_that_compiles_and_one_that_loads(tmp_path):
    """Numba may take other copies of the kernels in the second process."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", SCRIPT]
    for _ in range(2):
        found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        assert found.stdout.split() == ["True", "True", "True"]
        assert any(tmp_path.rglob("derivatives.linearise*.nbc"))
