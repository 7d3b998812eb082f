"""Synthetic events that make the estimator compile and load all of its code."""

from collections.abc import Callable

import numpy as np

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.types.estimate import Estimator
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, SLICE_MS, Events, Window

type EstimatorFactory = Callable[[Camera, Config], Estimator]

WARM_UP_CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)

# Enough windows for a warm start, an adjustment of the memory, a flow fitted again with it, and a
# turn of the motion
_LENGTH = 90 * NS_PER_MS
WARM_UP_ENDS = tuple(_LENGTH + k * 45 * NS_PER_MS for k in range(8))  # ns
_EVENTS = 60_000
_SPEED = 200  # px/s along x; along y, too, from the turn on
_TURN = 300 * NS_PER_MS


def warm_up(make_estimator: EstimatorFactory) -> None:
    """Estimate windows and latest twists of synthetic events, by both kinds of motion."""
    from emoflow_ros.core.products.present_motion import PresentMotion

    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, WARM_UP_ENDS[-1], _EVENTS))
    dots = rng.integers(0, (WARM_UP_CAMERA.width, WARM_UP_CAMERA.height), (500, 2))
    x, y = dots[rng.integers(0, len(dots), len(t))].T
    moved = (x + t * _SPEED // NS_PER_S) % WARM_UP_CAMERA.width
    down = (y + np.maximum(t - _TURN, 0) * _SPEED // NS_PER_S) % WARM_UP_CAMERA.height
    events = Events(moved.astype(np.uint16), down.astype(np.uint16), t, x % 2 == 0)
    for model, ends in (("auto", WARM_UP_ENDS), ("rotation", WARM_UP_ENDS[:2])):
        config = load_config(overrides={"estimator.model": model})
        assert isinstance(config.estimator, LatticeConfig)
        estimator = make_estimator(WARM_UP_CAMERA, config)
        present = PresentMotion(WARM_UP_CAMERA, config.estimator)
        for end in ends:
            window = Window(0, end, events[: np.searchsorted(t, end)])
            present.know(estimator.estimate(window.since(end - _LENGTH)))
            present.estimate(window.since(end - int(SLICE_MS * NS_PER_MS)))
