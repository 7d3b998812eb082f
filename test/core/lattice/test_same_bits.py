"""Estimates have the same bits in every process, whether it compiles, loads or unpickles.

And whatever was compiled before, in whichever order (`numerics.jit`).
"""

import os
import subprocess
import sys
from pathlib import Path

SCRIPT = """
import hashlib
import pickle
import sys
from pathlib import Path

import numpy as np
from emoflow_ros.core.lattice import derivatives
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.config import load_config
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.estimator import LatticeEstimator
from emoflow_ros.core.types.events import Events, Window
from emoflow_ros.factory import make_estimator
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.window_events import WindowEvents
import emoflow_ros.evaluation.run_progress  # how checkpoints pickle what is in an estimator

kept = Path(sys.argv[2])
size, length, middle = 30_000, 90_000_000, np.array([173.0, 130.0])


def window(k):  # dots that turn about the optical axis in windows 0 and 1, then move sideways
    rng = np.random.default_rng(k)
    dots = np.random.default_rng(99).uniform((20, 20), (326, 240), (2000, 2)) - middle
    of, t = rng.integers(0, 2000, size), np.sort(rng.integers(0, length, size))
    if k < 2:
        angle = 0.1 * (k + t / length)
        x, y = dots[of].T
        moved = np.stack([x * np.cos(angle) - y * np.sin(angle),
                          x * np.sin(angle) + y * np.cos(angle)], axis=1)
    else:
        near = 1 + of % 3
        moved = dots[of] - np.outer((k - 2 + t / length) * near, (4, 1))
    x, y = np.clip(moved + middle, 0, (345, 259)).astype(np.uint16).T
    events = Events(x.copy(), y.copy(), t + k * length, of < 1000)
    return Window(k * length, (k + 1) * length, events)


def begun(estimator):  # after two windows
    models = [estimator.estimate(window(k)).model for k in range(2)]
    assert models == ["rotation", "rotation"], models
    return estimator


def estimates(estimator):  # a digest of the next seven
    digest, models = hashlib.sha256(), []
    for k in range(2, 9):
        found = estimator.estimate(window(k))
        models.append(found.model)
        quality = found.quality
        numbers = np.float64([quality.contrast_gain, quality.residual_px, quality.inlier_fraction])
        for value in (found.flow.values, found.angular, found.linear, found.covariance, numbers):
            digest.update(np.ascontiguousarray(value))
    assert models[-1] == "full", models
    return digest.hexdigest()


lattice = Lattice.with_spacing(240, 180, 26.0)
if sys.argv[1] == "unpickle":
    alone, remembering, contrast = pickle.loads(kept.read_bytes())
else:
    camera, config = Camera(346, 260, 200.0, 200.0, 173.0, 130.0), load_config("realtime")
    alone, contrast = begun(LatticeEstimator(camera, config.estimator)), Contrast(lattice, 0.5)
    remembering = begun(make_estimator(camera, config)) if sys.argv[1] != "lattice" else None
    kept.write_bytes(pickle.dumps((alone, remembering, contrast)))
if sys.argv[1] in ("load", "unpickle"):
    assert not derivatives.linearise.stats.cache_misses

digest = hashlib.sha256(estimates(alone).encode())

rng = np.random.default_rng(0)
x, y, s = rng.random((3, size)).astype(np.float32)
events = WindowEvents(239 * x, 179 * y, np.sort(s), np.float32(rng.normal(size=size)))
flow = np.float32(rng.normal(scale=5, size=lattice.shape))
digest.update(np.float64(contrast.sharpen(events, flow)))
digest.update(contrast.image)
digest.update(contrast.scores(events, np.float32([(0, 0), (3.5, -2.25)])))
cells = contrast.linearise(events, flow)
for part in cells:
    digest.update(part)

print(digest.hexdigest())
if remembering is not None:
    print(estimates(remembering))
"""


# What another process may have compiled before: other parts, and some of what the estimator needs.
BEFORE = """
import numpy as np
from emoflow_ros.core.lattice import kernels
from emoflow_ros.core.numerics.smoothing import outwards, smooth
from emoflow_ros.core.lattice.contrast import TAPS
from emoflow_ros.core.stream.cleaning import without_flicker, without_hot_pixels
from emoflow_ros.core.types.events import Events

rng = np.random.default_rng(0)
x, y = rng.integers(0, 64, (2, 5000)).astype(np.uint16)
events = Events(x, y, np.arange(5000) * 20_000, x < y)
without_flicker(events, 64, 64)
without_hot_pixels(events, 64, 64)
image = np.zeros((1, 64, 64), np.float32)
kernels.vote(np.ones((2, 9), np.float32), np.ones(9, np.float32), np.zeros(9, np.int32), 1.0, image)
smooth(image, outwards(TAPS))
kernels.sum_of_squares(image)
"""


def start(folder: Path, cache: str, code: str, *arguments: str) -> subprocess.Popen[str]:
    """Start a process; the order of a set, which is in numba's names, is another one by code."""
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(folder / cache), "PYTHONHASHSEED": str(len(code))
    }  # fmt: skip
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def output(process: subprocess.Popen[str]) -> str:
    out, error = process.communicate()
    assert process.returncode == 0, error
    return out


def test_processes_that_compile_load_and_unpickle(tmp_path: Path) -> None:
    kept = str(tmp_path / "estimator.pickle")
    compiled = output(start(tmp_path, "empty", SCRIPT, "compile", kept))
    assert len(compiled.split()) == 2
    for how in ("load", "unpickle"):
        assert output(start(tmp_path, "empty", SCRIPT, how, kept)) == compiled


def test_what_was_compiled_before_changes_no_bit_of_the_lattice(tmp_path: Path) -> None:
    output(start(tmp_path, "filled before", BEFORE))
    caches = ("empty", "filled before")
    both = [start(tmp_path, c, SCRIPT, "lattice", str(tmp_path / f"{c}.pickle")) for c in caches]
    one, other = (output(process) for process in both)
    assert len(one.split()) == 1
    assert one == other
