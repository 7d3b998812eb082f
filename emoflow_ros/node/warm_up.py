"""Synthetic events that make the estimator compile and load all of its code."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.config import Config, load_config
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.types.estimate import (
    Estimate,
    Estimator,
    MotionModel,
    Quality,
    Status,
)
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

    for model, ends in (("auto", WARM_UP_ENDS), ("rotation", WARM_UP_ENDS[:2])):
        config = load_config(overrides={"estimator.model": model})
        assert isinstance(config.estimator, LatticeConfig)
        estimator = make_estimator(WARM_UP_CAMERA, config)
        present = PresentMotion(WARM_UP_CAMERA, config.estimator)
        for window, part in _windows(ends):
            present.know(estimator.estimate(window))
            present.estimate(part)


def warm_up_memory() -> None:
    """Follow and adjust patches of the same events, with a flow that is told: without a lattice."""
    from emoflow_ros.core.remembering import RememberingEstimator

    memory = RememberingEstimator(
        _Told(), WARM_UP_CAMERA, lambda estimate, depths: (estimate, None)
    )
    for window, _ in _windows(WARM_UP_ENDS):
        memory.estimate(window)


def _windows(ends: Iterable[int]) -> Iterator[tuple[Window, Window]]:
    """Make windows of dots that turn, each with the slice at its end."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, WARM_UP_ENDS[-1], _EVENTS))
    dots = rng.integers(0, (WARM_UP_CAMERA.width, WARM_UP_CAMERA.height), (500, 2))
    x, y = dots[rng.integers(0, len(dots), len(t))].T
    moved = (x + t * _SPEED // NS_PER_S) % WARM_UP_CAMERA.width
    down = (y + np.maximum(t - _TURN, 0) * _SPEED // NS_PER_S) % WARM_UP_CAMERA.height
    events = Events(moved.astype(np.uint16), down.astype(np.uint16), t, x % 2 == 0)
    for end in ends:
        window = Window(0, end, events[: np.searchsorted(t, end)])
        yield window.since(end - _LENGTH), window.since(end - int(SLICE_MS * NS_PER_MS))


@dataclass(frozen=True)
class _Uniform:
    """One velocity (2,) px/s everywhere (a FlowSampler as far as a memory needs one)."""

    px_s: NDArray[np.float64]

    def tracks(self, points: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
        return np.stack([points + self.px_s * ((t - times[0]) / NS_PER_S) for t in times])


class _Told:
    """Tells how the dots move, as a lattice would (an Estimator)."""

    def reset(self) -> None:
        pass

    def estimate(self, window: Window) -> Estimate:
        t = (window.t_start + window.t_end) // 2
        u, v = _SPEED, _SPEED * float(t > _TURN)
        flow: Any = _Uniform(np.array([u, v]))
        return Estimate(
            window.t_start,
            window.t_end,
            t,
            Status.OK,
            Quality(len(window.events)),
            MotionModel.ROTATION,
            angular=np.array([v / WARM_UP_CAMERA.fy, -u / WARM_UP_CAMERA.fx, 0]),
            covariance=1e-3 * np.eye(6),
            flow=flow,
        )
