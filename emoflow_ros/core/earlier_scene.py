"""What the scene of an earlier window makes of a later one: a check that shares no events with it.

A flow that is wrong in one window is seldom wrong in the same way a quarter of a second later. So
the scene of an earlier window, with only the six numbers of the camera's motion fitted to the
events, is held against the flow of a later window.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.contrast import ImageContrast, WindowEvents
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.core.known_scene import KnownScene, inverse_depths, motion_covariance
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.normal_equations import NormalEquations

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

# Errors of a younger scene are those of the window; an older one has left the image.
_YOUNGEST_NS, _OLDEST_NS = 100 * NS_PER_MS, 450 * NS_PER_MS
_BEST_NS = 225 * NS_PER_MS
# Scale of the image and steps: coarse first, for the motion has changed since.
_STEPS = ((0.25, 1), (0.5, 3))
SCALES = tuple(scale for scale, _ in _STEPS)
_EVENTS = 8_000  # are enough for six numbers


@dataclass(frozen=True)
class Recalled:
    """A window as the scene of an earlier one explains it.

    Attributes:
        flow: (columns, rows, times, 2) px per window.
        w: (3,) rad/s.
    """

    flow: F32
    w: Array


@dataclass(frozen=True)
class EarlierScene:
    """What a window has shown.

    Attributes:
        t_start, t_end: the window, ns.
        flow: (columns, rows, times, 2) px per window.
        w, v: (3,) in rad/s, and the unit direction of travel, in front of which the scene lies.
        covariance: (6, 6) of both.
        travels: whether v is known.
    """

    t_start: int
    t_end: int
    flow: F32
    w: Array
    v: Array
    covariance: Array
    travels: bool

    @classmethod
    def shown(cls, estimate: Estimate, flow: F32) -> "EarlierScene":
        """Take it from an estimate and the flow (columns, rows, times, 2) of its lattice."""
        return cls(
            estimate.t_start, estimate.t_end, flow, estimate.angular, estimate.linear,
            motion_covariance(estimate), estimate.translation_observable,
        )  # fmt: skip

    @property
    def t(self) -> int:
        """The window's middle, ns."""
        return (self.t_start + self.t_end) // 2


class EarlierScenes:
    """Keeps the scenes of the last half second, and explains windows by them.

    Args:
        lattice: of the flow.
        epipolar: its constraint.
        contrasts: by scale, those of `_STEPS`.
        config: for the drift of the motion.
    """

    def __init__(
        self,
        lattice: Lattice,
        epipolar: NodeEpipolar,
        contrasts: Mapping[float, ImageContrast],
        config: LatticeConfig,
    ) -> None:
        self._lattice = lattice
        self._epipolar = epipolar
        self._contrasts = contrasts
        self._drift = np.radians(np.repeat([config.angular_drift, config.direction_drift], 3)) ** 2
        self._equations = NormalEquations(lattice, 0)
        self._scenes: deque[EarlierScene] = deque()

    def forget(self) -> None:
        """Forget all scenes, for example after a jump in time."""
        self._scenes.clear()

    def keep(self, scene: EarlierScene) -> None:
        """Keep a scene for later windows."""
        while self._scenes and scene.t - self._scenes[0].t > _OLDEST_NS:
            self._scenes.popleft()
        self._scenes.append(scene)

    def choose(self, window: Window) -> EarlierScene | None:
        """Choose the scene nearest to 225 ms before a window that shares no events with it.

        Returns:
            None without one of 100 to 450 ms before.
        """
        middle = (window.t_start + window.t_end) // 2
        apart = (s for s in self._scenes if s.t_end <= window.t_start)
        old_enough = (s for s in apart if _YOUNGEST_NS <= middle - s.t <= _OLDEST_NS)
        return min(old_enough, key=lambda s: abs(middle - s.t - _BEST_NS), default=None)

    def explain(self, scene: EarlierScene, window: Window, events: WindowEvents) -> Recalled | None:
        """Explain a window by an earlier scene and another motion of the camera.

        Args:
            scene: of before the window.
            window: its interval.
            events: of the window.

        Returns:
            None if no motion is the best one, or the scene is not finite.
        """
        middle = (window.t_start + window.t_end) // 2
        known = self._carried(scene, middle)
        free = 6 if scene.travels else 3
        covariance = scene.covariance + np.diag(self._drift * (middle - scene.t) / NS_PER_S)
        change = np.zeros(free)
        few = events.every(max(1, len(events) // _EVENTS))
        try:
            prior = change, np.linalg.inv(covariance[:free, :free])
            for scale, steps in _STEPS:
                contrast = self._contrasts[scale]
                change, _ = known.fit(
                    contrast, self._equations, few, window.duration, prior, change, steps
                )
        except np.linalg.LinAlgError:
            return None
        w = scene.w + change[:3]
        if not np.isfinite(w).all():
            return None
        return Recalled(known.field(self._lattice, window.duration, change), w)

    def _carried(self, scene: EarlierScene, t: int) -> KnownScene:
        """Move a scene along with its flow to time t."""
        lattice, epipolar = self._lattice, self._epipolar
        length = scene.t_end - scene.t_start
        rate = scene.flow.mean(axis=2).reshape(-1, 2).astype(np.float64) * (NS_PER_S / length)
        depth = np.zeros(len(rate))
        if scene.travels:
            depth = inverse_depths(epipolar, rate, scene.w, scene.v)
        rest = rate - _rigid(epipolar, scene, depth)
        now = (t - scene.t_start) / length
        source = lattice.advance(scene.flow, lattice.pixels, now, 0.5)
        usable = epipolar.usable.astype(np.float64)  # else the lens has no inverse
        near = np.maximum(lattice.interpolate(usable, source), 1e-3)
        depth, *rest_xy = (lattice.interpolate(usable * a, source) / near for a in (depth, *rest.T))
        rest = np.stack(rest_xy, axis=-1)
        flow = _rigid(epipolar, scene, depth) + rest
        return KnownScene.at_depths(epipolar, flow, depth)


def _rigid(epipolar: NodeEpipolar, scene: EarlierScene, inverse_depth: Array) -> Array:
    """Flow (nodes, 2) of static points, px/s."""
    flow: Array = epipolar.b @ scene.w + inverse_depth[:, None] * (epipolar.a @ scene.v)
    return flow
