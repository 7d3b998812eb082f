"""Streams of a scene of edges that moves at any speed over noise, and what is measured of them."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import SplineMotion
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.products.continuous import ContinuousEstimator, State
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Events, Window

CAMERA = Camera(346, 260, 226.0, 226.0, 173.0, 130.0)
LATTICE = Lattice(346, 260, 3, 3, 2)
LENGTH = 135 * NS_PER_MS
EDGES, EDGE_PX = 60, 80
DOTS = EDGES * EDGE_PX
FOCAL_PX = 226.0
STRIDE_MS = 67.5
MOVES_UNTIL_S = 0.4


def scene(
    px_s: float | Callable[[float], float], duration_s: float, noise_hz: float = 0.2
) -> Events:
    """Upright edges that move right and leave an event a px, over noise; they go round."""
    rng = np.random.default_rng(0)
    speed = px_s if callable(px_s) else lambda t: px_s
    steps = np.arange(0.0, duration_s, 1e-3)
    way = np.cumsum([speed(t) for t in steps]) * 1e-3
    x0 = np.repeat(rng.uniform(0, 346, EDGES), EDGE_PX)
    rows = np.repeat(rng.integers(0, 260, EDGES), EDGE_PX) + np.tile(np.arange(EDGE_PX), EDGES)
    phase = rng.uniform(0, 1, DOTS)
    whole = np.arange(1.0, way[-1] + 1)[:, None]
    seen = (whole - phase < way[-1]).ravel()
    t = np.interp(whole - phase, way, steps).ravel()[seen]
    x = ((x0 + whole) % 346).ravel()[seen]
    y = np.tile(rows % 260, len(whole))[seen]
    p = np.tile(np.repeat(rng.random(EDGES) < 0.5, EDGE_PX), len(whole))[seen]
    n = rng.poisson(noise_hz * 346 * 260 * duration_s)
    t = np.concatenate([t, rng.uniform(0, duration_s, n)])
    x = np.concatenate([x, rng.integers(0, 346, n)])
    y = np.concatenate([y, rng.integers(0, 260, n)])
    p = np.concatenate([p, rng.random(n) < 0.5])
    order = np.argsort(t)
    return Events(
        x[order].astype(np.uint16), y[order].astype(np.uint16),
        (t[order] * NS_PER_S).astype(np.int64), p[order],
    )  # fmt: skip


def window(events: Events, end_ms: float, length: int = LENGTH) -> Window:
    end = round(end_ms * NS_PER_MS)
    first, last = np.searchsorted(events.t, [end - length, end])
    return Window(end - length, end, events[first:last])


def measured(at: Window, px_s: float, sigma: float = 0.01) -> Estimate:
    """What an estimator tells of a window in which the image moves right at this speed."""
    flow = np.zeros(LATTICE.shape, np.float32)
    flow[..., 0] = px_s * at.duration
    w = np.array([0.0, -px_s / FOCAL_PX, 0.0])
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = sigma**2 * np.eye(3)
    covariance[0, 0] = -1.0
    motion = SplineMotion(at.t_start, at.t_end, np.tile(w, (4, 1)), np.zeros((4, 3)))
    return Estimate(
        at.t_start, at.t_end, (at.t_start + at.t_end) // 2, Status.OK, Quality(5000),
        MotionModel.ROTATION, np.zeros(3), w, covariance,
        LatticeFlow(LATTICE, flow, at.t_start, at.t_end), motion,
    )  # fmt: skip


def nothing(at: Window, status: Status = Status.NO_MOTION) -> Estimate:
    """What an estimator tells of a window in which it finds nothing."""
    middle = (at.t_start + at.t_end) // 2
    return Estimate(at.t_start, at.t_end, middle, status, Quality(9, stop_reason=str(status)))


class Scripted:
    """Measures nothing (an Estimator)."""

    def estimate(self, window: Window) -> Estimate:
        return nothing(window)

    def reset(self) -> None:
        pass


def continuous() -> ContinuousEstimator:
    """The stream over an estimator that measures nothing."""
    return ContinuousEstimator(Scripted(), CAMERA, LatticeConfig())


def darkness(until_s: float) -> Events:
    """A scene that moves, until its light goes out and only noise is left."""
    events = scene(100.0, until_s) if until_s else Events.empty()
    rng = np.random.default_rng(1)
    n = 90_000
    x, y = (rng.integers(0, side, n).astype(np.uint16) for side in CAMERA.size)
    t = np.sort(rng.integers(round(until_s * 1e9), round(until_s * 1e9) + 8 * NS_PER_MS, n))
    noise = scene(0.0, 2.0)
    noise = noise[noise.t > t[-1]]
    return Events.concatenate([events, Events(x, y, t, np.zeros(n, bool)), noise])


def go_on(
    stream: ContinuousEstimator, state: State, events: Events, since_ms: float, until_ms: float,
    status: Status = Status.NO_MOTION,
) -> list[Estimate]:  # fmt: skip
    """Estimates of windows in which nothing is measured."""
    told = []
    for end in np.arange(since_ms, until_ms, STRIDE_MS):
        at = window(events, end)
        state, found = stream.step(state, at, nothing(at, status))
        told.append(found)
    assert all(b.t > a.t for a, b in pairwise(told))
    return told


def widest(told: list[Estimate]) -> None:
    """Nothing is known: zero within what cameras do, which is not rest."""
    assert {e.status for e in told} == {Status.BOUNDED}
    for found in told:
        np.testing.assert_array_equal([found.angular, found.linear], 0)
        np.testing.assert_allclose(np.degrees(np.sqrt(np.diag(found.covariance)[3:])), 60.0)
        assert found.covariance[0, 0] == -1 and found.bound is None


def stops(noise_hz: float = 0.2) -> Events:
    """A scene that moves at 100 px/s until it stops."""
    return scene(lambda t: 100.0 if t < MOVES_UNTIL_S else 0.0, 2.0, noise_hz)


def after_motion(stream: ContinuousEstimator, events: Events, until_ms: float = 400.0) -> State:
    """State after windows that were measured."""
    state = State()
    for end in np.arange(LENGTH / NS_PER_MS, until_ms + 1e-3, STRIDE_MS):
        at = window(events, end)
        state, told = stream.step(state, at, measured(at, 100.0))
        assert told.status is Status.OK
    return state
