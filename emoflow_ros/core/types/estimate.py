"""What an estimator returns for a window, and what every estimator offers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.events import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.core.types.gyro import GyroStatus

REMEMBERED = "remembered"  # stop reason: by patches alone, the window itself shows no motion


class Status(StrEnum):
    """Where a window's motion comes from; the last four: why there is none."""

    OK = "ok"  # measured
    STILL = "still"  # the events show that the camera is at rest (core.products.gauge)
    CARRIED = "carried"  # not measured: the last motion goes on, and gets less sure
    BOUNDED = "bounded"  # not measured for longer: the events only show how small it is
    LOST = "lost"  # not measured for longer, and nothing bounds it
    TOO_FEW_EVENTS = "too_few_events"
    NO_MOTION = "no_motion"  # the events do not move together, as with a camera at rest
    DIVERGED = "diverged"

    @property
    def told(self) -> bool:
        """Whether there is a motion: measured, at rest, carried on or bounded."""
        return self in (Status.OK, Status.STILL, Status.CARRIED, Status.BOUNDED)


class MotionModel(StrEnum):
    """The freedom that the window's events gave evidence for."""

    FULL = "full"  # angular velocity and direction of linear velocity
    ROTATION = "rotation"
    TRANSLATION = "translation"
    STATIC = "static"


class FlowSampler(Protocol):
    """The window's flow field, continuous in time. Times are in nanoseconds."""

    def velocity(self, t: int) -> NDArray[np.float32]:
        """Flow at time t, (height, width, 2) in px/s: u right, v down."""
        ...

    def displacement(self, t0: int, t1: int) -> NDArray[np.float32]:
        """Where the pixels of time t0 are at t1, minus where they were: (height, width, 2) px."""
        ...

    def tracks(self, points: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
        """Positions (len(times), N, 2) in px of points (N, 2) given at times[0]."""
        ...


def velocity_at(flow: FlowSampler, points: NDArray[np.float64], t: int) -> NDArray[np.float64]:
    """Flow at points (N, 2) px at time t, (N, 2) px/s: that of the next millisecond."""
    moved = flow.tracks(points, [t, t + NS_PER_MS])[1] - points
    return moved * (NS_PER_S / NS_PER_MS)


class Motion(Protocol):
    """The window's egomotion, continuous in time, in the camera's optical frame."""

    def angular(self, t: int) -> NDArray[np.float64]:
        """Angular velocity at time t, (3,) rad/s."""
        ...

    def linear(self, t: int) -> NDArray[np.float64]:
        """Direction of the linear velocity at time t, (3,) unit; zeros if not observable."""
        ...


def angular_over(motion: Motion, t_start: int, t_end: int, times: int) -> NDArray[np.float64]:
    """Angular velocities (times, 3) rad/s, evenly from a start to an end (ns).

    Times are whole ns from the start: the origin of the clock changes no bit.
    """
    at = t_start + np.arange(times) * (t_end - t_start) // (times - 1)
    return np.array([motion.angular(int(t)) for t in at])


class SpeedBound(Protocol):
    """How fast the image moves at most, by the events of a window (core.products.gauge)."""

    def speed(self, window: Window) -> float | None:
        """Return px/s of the working image; None where the events do not tell."""
        ...

    def rotation_covariance(self, speed: float) -> NDArray[np.float64]:
        """Covariance (3, 3), (rad/s)^2, of w = 0 where the image moves at a speed at most."""
        ...

    def rest_covariance(self, speed: float) -> NDArray[np.float64]:
        """Covariance (6, 6) of (linear, angular) at rest: (m/s)^2 and (rad/s)^2."""
        ...


@dataclass(frozen=True)
class Quality:
    """How far a window's estimate can be trusted.

    Attributes:
        events: events of the window that were used.
        iterations: steps of the optimiser.
        stop_reason: `converged`, `iterations`, `deadline`, `remembered`, or why nothing was
            measured: a Status value, or `brightness` where the light has changed.
        contrast_gain: variance of the warped over that of the unwarped image (FWL).
        residual_px: robust scale of the epipolar residual over the window, in px.
        inlier_fraction: share of the residuals within 3 robust scales.
        runtime_s: wall time of the whole estimate.
        warm: whether the previous window's result was the start, or what was expected.
        change_px: how far the first or the last third of the window moves off the fit, in px of
            the working image: what the fit's model of time leaves out. NaN where not known.
    """

    events: int
    iterations: int = 0
    stop_reason: str = ""
    contrast_gain: float = float("nan")
    residual_px: float = float("nan")
    inlier_fraction: float = float("nan")
    runtime_s: float = 0.0
    warm: bool = False
    change_px: float = float("nan")


def _unknown_covariance() -> NDArray[np.float64]:
    covariance = np.zeros((6, 6))
    covariance[0, 0] = -1.0
    return covariance


@dataclass(frozen=True)
class Estimate:
    """Egomotion and flow of one window.

    Attributes:
        t_start, t_end: the window, ns.
        t: the time that linear and angular hold at (the window's middle), ns.
        status: where the motion comes from, or why there is none.
        model: which motion model the evidence supports.
        linear: (3,) unit direction of the camera's velocity in its optical frame; zeros
            where translation is not observable.
        angular: (3,) rad/s in the camera's optical frame.
        covariance: (6, 6) of (linear, angular), the order of ROS twists; [0, 0] is -1
            where translation is not observable (REP-145's idiom). At rest linear is zero, and its
            covariance is that of a velocity in m/s.
        flow: the flow field; None unless the status is OK. With a gyro it is None, too, where the
            events gave nothing.
        motion: the egomotion over the window; None unless it is told.
        quality: the record behind the status.
        gyro: whether a gyro took part.
        bound: what bounds the speed of later events; None where nothing does.
        angular_walk: how restless the camera is, variance of the change of w per time, rad^2/s^3;
            None where it was not learnt.
    """

    t_start: int
    t_end: int
    t: int
    status: Status
    quality: Quality
    model: MotionModel = MotionModel.STATIC
    linear: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    angular: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    covariance: NDArray[np.float64] = field(default_factory=_unknown_covariance)
    flow: FlowSampler | None = None
    motion: Motion | None = None
    gyro: GyroStatus = field(default_factory=GyroStatus)
    bound: SpeedBound | None = None
    angular_walk: float | None = None

    @property
    def told(self) -> bool:
        """Whether there is a motion: measured, at rest, carried on or bounded."""
        return self.status.told

    @property
    def by_events(self) -> Status:
        """What the events gave: `status`, unless the gyro alone tells the motion (status OK)."""
        reason = self.quality.stop_reason
        by_gyro = self.status is Status.OK and reason in {str(status) for status in Status}
        return Status(reason) if by_gyro else self.status

    @property
    def translation_observable(self) -> bool:
        """Whether `linear` carries a direction."""
        return self.told and self.model in (
            MotionModel.FULL,
            MotionModel.TRANSLATION,
        )


class Estimator(Protocol):
    """Estimates one window after another; what is learnt from one warms up the next."""

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to one window."""
        ...

    def reset(self) -> None:
        """Forget previous windows: the next one starts cold."""
        ...
