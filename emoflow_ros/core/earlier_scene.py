"""The scene that a window has shown, and the flow that it makes once the camera moves otherwise.

At a node with the flow u0 and the inverse depth rho, both per second, seen under the motion
(w0, v0), another motion (w, v) makes the flow

    u = u0 + b (w - w0) + rho a (v - v0),

with the matrices a and b of the motion field (core.camera_motion). These are six unknowns instead
of a flow's many hundreds: few events tell them.

The scene of an earlier window, fitted like this to the events of a later one, is held against the
flow of that window: a check that shares no events with it. A flow that is wrong in one window is
seldom wrong in the same way a quarter of a second later.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.belief import INFORMATION_EXCESS, Belief
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.window_events import WindowEvents

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
class KnownScene:
    """Flow and inverse depths at the nodes of a lattice, under a motion of the camera.

    Attributes:
        flow: (nodes, 2) px/s.
        by_motion: (nodes, 2, 6) its derivatives by w (rad/s) and v (in units of the speed).
    """

    flow: Array
    by_motion: Array

    @classmethod
    def at_depths(cls, epipolar: NodeEpipolar, flow: Array, inverse_depth: Array) -> "KnownScene":
        """Take a flow (nodes, 2) and inverse depths (nodes,); zero where v does not count."""
        of_v = inverse_depth[:, None, None] * epipolar.a
        by_motion = np.concatenate([epipolar.b, of_v], axis=-1)
        return cls(flow, by_motion * epipolar.usable[:, None, None])

    def fit(
        self,
        contrasts: Mapping[float, Contrast],
        steps: Sequence[tuple[float, int]],
        events: WindowEvents,
        duration: float,
        prior: tuple[Array, Array],
    ) -> tuple[Array, Array]:
        """Fit the change of the motion to events, by Newton steps on their contrast.

        Args:
            contrasts: by scale.
            steps: scales and how many steps at each, in turn.
            events: of the window.
            duration: of the window, s.
            prior: expected change (m,), to start from, and the information (m, m) on it; m = 3
                leaves v as it is.

        Returns:
            The change (m,) of w in rad/s and v, and the information (m, m) on it.

        Raises:
            numpy.linalg.LinAlgError: there is no best change.
        """
        expected, certainty = prior
        change, information = expected, certainty
        by_motion = np.ascontiguousarray(duration * self.by_motion[..., : len(expected)])
        for contrast in (contrasts[scale] for scale, number in steps for _ in range(number)):
            cells = contrast.linearise(events, self.field(contrast.lattice, duration, change))
            force, curvature = cells.project(by_motion)
            information = curvature / INFORMATION_EXCESS + certainty
            push = force / INFORMATION_EXCESS - certainty @ (change - expected)
            change = change + np.linalg.solve(information, push)
        return change, information

    def field(self, lattice: Lattice, duration: float, change: Array) -> NDArray[np.float32]:
        """Flow (columns, rows, times, 2), px per window of `duration` s, after a change (m,)."""
        still = duration * (self.flow + self.by_motion[..., : len(change)] @ change)
        field = np.empty(lattice.shape, np.float32)
        field[:] = still.reshape(lattice.columns, lattice.rows, 1, 2)
        return field


def inverse_depths(epipolar: NodeEpipolar, flow: Array, w: Array, v: Array) -> Array:
    """Read inverse depths (nodes,) off a flow (nodes, 2), 0 at the least.

    Args:
        epipolar: the lattice's constraint.
        flow: per second.
        w, v: (3,) rad per second, and the direction of travel.
    """
    line = epipolar.a @ v
    along = ((flow - epipolar.b @ w) * line).sum(axis=-1)
    return np.maximum(0.0, along / ((line**2).sum(axis=-1) + epipolar.soft**2))


def motion_covariance(estimate: Estimate, v: Array) -> Array:
    """Return the covariance (6, 6) of (w, v) of an estimate, v in units of the speed.

    It turns with v. Along v it is 1: nobody knows how the speed changes. Where v is not known, w
    stands alone.

    Args:
        estimate: of a window.
        v: (3,) unit direction of travel at the time in the window that is asked for.
    """
    order = np.r_[3:6, 0:3]
    covariance: Array = estimate.covariance[np.ix_(order, order)].copy()
    if estimate.translation_observable:
        turn = np.eye(6)
        turn[3:, 3:] = _least_turn(estimate.linear, v)
        covariance = turn @ covariance @ turn.T
        return Belief.of(estimate.t, estimate.angular, v, covariance).covariance
    covariance[3:, :3], covariance[:, 3:] = 0.0, 0.0
    return covariance


def _least_turn(before: Array, after: Array) -> Array:
    """Rotation (3, 3) by the least angle, under 180 degrees, from one unit vector to another."""
    both: Array = np.outer(after, before)
    across = both - both.T  # the cross product with before x after
    turn: Array = np.eye(3) + across + across @ across / max(1e-6, 1 + before @ after)
    return turn


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
            motion_covariance(estimate, estimate.linear), estimate.translation_observable,
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
        contrasts: Mapping[float, Contrast],
        config: LatticeConfig,
    ) -> None:
        self._lattice = lattice
        self._epipolar = epipolar
        self._contrasts = contrasts
        self._drift = np.radians(np.repeat([config.angular_drift, config.direction_drift], 3)) ** 2
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
        few = events.every(max(1, len(events) // _EVENTS))
        try:
            prior = np.zeros(free), np.linalg.inv(covariance[:free, :free])
            change, _ = known.fit(self._contrasts, _STEPS, few, window.duration, prior)
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
        values = np.column_stack([np.ones(len(depth)), depth, rest])
        values *= epipolar.usable[:, None]  # elsewhere the lens has no inverse
        values = lattice.interpolate(values, source)
        values = values[:, 1:] / np.maximum(values[:, :1], 1e-3)
        depth, rest = values[:, 0], values[:, 1:]
        flow = _rigid(epipolar, scene, depth) + rest
        return KnownScene.at_depths(epipolar, flow, depth)


def _rigid(epipolar: NodeEpipolar, scene: EarlierScene, inverse_depth: Array) -> Array:
    """Flow (nodes, 2) of static points, px/s."""
    flow: Array = epipolar.b @ scene.w + inverse_depth[:, None] * (epipolar.a @ scene.v)
    return flow
