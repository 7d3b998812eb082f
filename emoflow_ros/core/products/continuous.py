"""A motion for every window: what the stream of estimates says where nothing is measured.

Whatever estimator runs below, one place decides:

- a measured motion is told, however wide it is, held against how fast the events allow the image to
  move;
- `still`: the events of a scene that was seen move by less than 3 px/s (`gauge`): w and v are zero;
- `carried`: the last motion goes on as a random walk for half a second, held alike;
- `bounded`: later, w is zero within what the events allow, as long as they tell;
- `lost`: nothing is known.

Darkness is no rest: when most of the image gets darker or brighter at once, the scene is not known
any more. A camera that rests from its start and one that is covered send the same noise. Until
something was measured it is therefore never `still` but `bounded`, within what cameras do.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import CONTROL_POINTS, SplineMotion
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.products.gauge import Gauge, covered, structured, works
from emoflow_ros.core.products.motion_prior import HeldMotion, Known, carried
from emoflow_ros.core.products.settings import STREAM
from emoflow_ros.core.types.estimate import (
    REMEMBERED,
    Estimate,
    Estimator,
    MotionModel,
    Status,
)
from emoflow_ros.core.types.events import NS_PER_S, Events, Window
from emoflow_ros.core.types.gyro import GyroState

Array = NDArray[np.float64]

BRIGHTNESS = "brightness"


@dataclass(frozen=True)
class State:
    """What outlives a window.

    Attributes:
        end: of the last window, ns; None before the first one.
        t: the last time that a motion was told of, ns.
        motion: the last one that was told.
        measured: time of the last measurement, rest among them, ns.
        gauge: of the scene; None where it is not known.
        way_px: how far the image may have moved since it was gauged, px of the working image.
        on: usual share of ON events; None before any.
        dark: whether the light has changed since the last measurement.
    """

    end: int | None = None
    t: int | None = None
    motion: Known | None = None
    measured: int | None = None
    gauge: Gauge | None = None
    way_px: float = 0.0
    on: float | None = None
    dark: bool = False

    def carries(self, t: int) -> bool:
        """Whether something was measured so lately that its motion goes on until time t, ns."""
        return self.measured is not None and t - self.measured <= STREAM.carried_ns


class ContinuousEstimator:
    """Tells a motion for every window that allows it (an Estimator).

    Args:
        estimator: that measures.
        camera: whose pixels the events lie on.
        config: how fast the motion changes (`angular_drift`, `direction_drift`).
    """

    def __init__(self, estimator: Estimator, camera: Camera, config: LatticeConfig) -> None:
        self._estimator = estimator
        self._camera = camera
        self._drift = np.radians([config.angular_drift, config.direction_drift]) ** 2
        self._state = State()

    def reset(self) -> None:
        """Forget previous windows."""
        self._estimator.reset()
        self._state = State()

    def estimate(self, window: Window) -> Estimate:
        """Estimate a window, and tell its motion."""
        found = self._estimator.estimate(window)
        self._state, told = self.step(self._state, window, found)
        return told

    def step(self, state: State, window: Window, found: Estimate) -> tuple[State, Estimate]:
        """Tell the motion of a window.

        Args:
            state: of the windows before.
            window: its events.
            found: what the estimator measures of it.
        """
        if state.end is None or not 0 <= window.t_end - state.end <= STREAM.gap_ns:
            state = State()
        passed = window.duration if state.end is None else (window.t_end - state.end) / NS_PER_S
        state = replace(state, end=window.t_end)
        if self._light_changes(state, window):
            state, found = replace(state, gauge=None, dark=True), _disbelieved(found)
        moved, speed = self._bounded(state, window, passed)
        if found.status is not Status.OK:
            return self._unmeasured(moved, speed, window, found)
        if speed is not None:
            found = self._held(moved, speed, window, found)
        if found.quality.stop_reason == REMEMBERED:
            if _rest_covariance(moved, speed) is not None:
                return self._unmeasured(moved, speed, window, found)
            return self._unseen(moved, speed, found)
        if found.by_events is not Status.OK:
            return self._unseen(moved, speed, found)
        return self._measured(state, window, found)  # the scene is gauged again

    def _held(self, state: State, speed: float, window: Window, found: Estimate) -> Estimate:
        """Hold what was measured of w against how fast the image moves at most; a gyro's stays.

        w is that of the middle: the camera may have stopped until the end, of which `speed` is.
        """
        if found.motion is None or found.gyro.state is GyroState.USED:
            return found
        motion = Known(found.t, found.linear, found.angular, found.covariance)
        gauge = self._gauge(state)
        before = gauge.speed(window.until(found.t))
        if before is None:
            return found
        of_rest = gauge.rotation_covariance(max(speed, before))
        held = motion.held_against(of_rest)
        told = HeldMotion(found.motion, motion.share_against(of_rest))
        return replace(found, angular=held.angular, covariance=held.covariance, motion=told)

    def _measured(self, state: State, window: Window, found: Estimate) -> tuple[State, Estimate]:
        gauge = state.gauge
        if found.flow is not None:
            seen = Gauge.measured(self._camera, window, found)
            gauge = gauge if seen is None else seen.beside(gauge)
        motion = Known(found.t, found.linear, found.angular, found.covariance).narrow()
        if not motion.translates and found.translation_observable:
            found = replace(found, model=MotionModel.ROTATION, linear=np.zeros(3))
        found = replace(found, covariance=motion.covariance, bound=gauge)
        on = float(window.events.p.mean()) if len(window.events) else state.on
        if on is not None and state.on is not None:
            on = STREAM.kept * state.on + (1 - STREAM.kept) * on
        return State(state.end, found.t, motion, found.t, gauge, 0.0, on), found

    def _unmeasured(
        self, state: State, speed: float | None, window: Window, found: Estimate
    ) -> tuple[State, Estimate]:
        """Tell what the events and the motion before say where nothing was measured."""
        t = (window.t_start + window.t_end) // 2
        if state.t is not None:
            t = max(t, state.t + 1)  # a short part of the window before may have been later
        if state.dark:
            found = replace(found, quality=replace(found.quality, stop_reason=BRIGHTNESS))
        found = replace(found, t_start=window.t_start, t_end=window.t_end, t=t)
        rest = _rest_covariance(state, speed)
        if rest is not None:
            motion = Known(t, np.zeros(3), np.zeros(3), rest)
            state, status = replace(state, measured=t), Status.STILL
        elif speed is not None and (found.status is Status.NO_MOTION or not state.carries(t)):
            # What is carried on into a window that shows no motion is off by more than w = 0.
            share = STREAM.unseen if found.status is Status.NO_MOTION else 1.0
            motion = _within(t, share * self._gauge(state).rotation_covariance(speed))
            status = Status.BOUNDED
        elif state.motion is not None and state.carries(t):
            motion, status = carried(state.motion, t, *self._drift), Status.CARRIED
            if speed is not None:
                motion = motion.held_against(self._gauge(state).rotation_covariance(speed))
        elif state.measured is None and works(window.events):
            motion, status = _within(t, STREAM.any_w**2 * np.eye(3)), Status.BOUNDED
        elif state.measured is None:
            return state, found
        else:
            return replace(state, motion=None), replace(found, status=Status.LOST)
        return replace(state, t=t, motion=motion), _told(found, motion, status, state.gauge)

    def _unseen(self, state: State, speed: float | None, found: Estimate) -> tuple[State, Estimate]:
        """Tell what a gyro, or patches, measure in a window without a motion; at rest v is zero."""
        motion = Known(found.t, found.linear, found.angular, found.covariance)
        status = Status.OK
        rest = _rest_covariance(state, speed)
        if rest is not None:
            held = motion.held_against(rest[3:, 3:])
            rest[3:, 3:] = held.covariance[3:, 3:]
            motion = Known(found.t, np.zeros(3), held.angular, rest)
            status = Status.STILL
        state = replace(state, t=found.t, motion=motion, measured=found.t)
        if status is Status.OK:
            return state, replace(found, bound=state.gauge)
        return state, _told(found, motion, status, state.gauge)

    def _bounded(self, state: State, window: Window, passed: float) -> tuple[State, float | None]:
        """Tell how fast the image moves at most, px/s, and forget a scene that it may have left.

        `passed`: time since the window before, s.
        """
        gauge = state.gauge
        if gauge is None:
            if state.dark or not structured(window.events, self._camera):
                return state, None
            return state, self._gauge(state).speed(window)
        speed = gauge.speed(window)
        if speed is None:
            return state, None
        if speed > STREAM.rest_px_s:
            state = replace(state, way_px=state.way_px + speed * passed)
        if state.way_px > STREAM.lost_px:
            return replace(state, gauge=None), None
        return state, speed

    def _gauge(self, state: State) -> Gauge:
        return state.gauge or Gauge.supposed(self._camera)

    def _light_changes(self, state: State, window: Window) -> bool:
        """Tell whether most of the image gets darker, or most of it brighter, at once."""
        if state.on is None or not len(window.events):
            return False
        events = _fullest(window)
        on = float(events.p.mean())
        if min(on, 1 - on) > STREAM.one_sided or abs(on - state.on) < STREAM.apart:
            return False
        return covered(events, self._camera) > STREAM.covered


def _rest_covariance(state: State, speed: float | None) -> Array | None:
    """Covariance (6, 6) at rest, where a gauged scene moves so slowly, px/s; None elsewhere."""
    if speed is None or speed > STREAM.rest_px_s or state.gauge is None:
        return None
    return state.gauge.rest_covariance(speed)


def _disbelieved(found: Estimate) -> Estimate:
    """Return a window without what its events told; a gyro's angular velocity stays."""
    if found.gyro.state is not GyroState.USED:
        status = Status.NO_MOTION if found.status is Status.OK else found.status
        return replace(found, flow=None, status=status)
    return replace(
        found,
        flow=None,
        model=MotionModel.ROTATION,
        linear=np.zeros(3),
        covariance=without_translation(found.covariance),
        quality=replace(found.quality, stop_reason=str(Status.NO_MOTION)),
    )


def _within(t: int, of_w: Array) -> Known:
    """Return w = 0 within a covariance (3, 3), (rad/s)^2; nothing is known of v."""
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = of_w
    return Known(t, np.zeros(3), np.zeros(3), without_translation(covariance))


def _fullest(window: Window) -> Events:
    """Return the events of the fullest 20 ms of a window."""
    edges = np.arange(window.t_start, window.t_end + STREAM.part_ns, STREAM.part_ns)
    places = np.searchsorted(window.events.t, edges)
    places[-1] = len(window.events)
    first = int(np.diff(places).argmax())
    return window.events[places[first] : places[first + 1]]


def _told(found: Estimate, motion: Known, status: Status, bound: Gauge | None) -> Estimate:
    """Put a motion that was not measured into an estimate; it is constant over the window."""
    model = MotionModel.ROTATION if motion.angular.any() else MotionModel.STATIC
    points = (np.tile(values, (CONTROL_POINTS, 1)) for values in (motion.angular, motion.linear))
    return replace(
        found,
        status=status,
        model=MotionModel.FULL if motion.translates else model,
        linear=motion.linear,
        angular=motion.angular,
        covariance=motion.covariance,
        flow=None,
        motion=SplineMotion(found.t_start, found.t_end, *points),
        bound=bound,
    )
