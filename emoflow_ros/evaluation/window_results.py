"""What an evaluation knows about one window: the estimate, the truth and their difference."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.types.estimate import Estimate, Quality, Status
from emoflow_ros.core.types.events import Window
from emoflow_ros.evaluation.metrics import (
    FlowErrors,
    Mask,
    angle_deg,
    at_pixels,
    event_mask,
    flow_errors,
    known_flow_mask,
)
from emoflow_ros.evaluation.slicers import compared_part
from emoflow_ros.evaluation.track_errors import TrackErrors
from emoflow_ros.truth import TrueFlow, TrueTwist, Truth

Vector = NDArray[np.float64]
# Below these limits the direction of a true velocity is not compared.
MIN_TRUE_SPEED = 0.05  # m/s
MIN_TRUE_RATE = np.radians(5.0)  # rad/s


@dataclass(frozen=True)
class WindowResult:
    """One window of an evaluation.

    Attributes:
        index: position in the evaluation.
        t_start, t_end: the interval that is compared, ns: the window, but for clips.
        events: all events in the window, also those that were not used.
        status: a Status value.
        model: a MotionModel value.
        linear: (3,) unit direction; NaN where not observable.
        angular: (3,) rad/s; NaN where there is no estimate.
        sigma: (6,) standard deviations of (linear, angular); NaN where unknown.
        truth: the true velocity at the window's middle, where known.
        flow: errors of the displacement over the window, where the truth is known.
        quality: the estimator's own record.
        note: the exception, where the estimator raised one.
        tracks: errors of the point tracks at the window's end, where points are tracked.
        static_flow: `flow` without the pixels of objects that move by themselves, where the
            truth knows of one in the image.
        other_truths: the velocity that each of Truth.other_twists says.
        pose: true world-from-camera (4, 4) at the window's middle, where known.
        gyro: whether a gyro took part, and if not, why: a GyroStatus in words.
        relative_speed: the camera's, up to one factor for the recording; NaN where unknown.
    """

    index: int
    t_start: int
    t_end: int
    events: int
    status: str
    model: str
    linear: Vector
    angular: Vector
    sigma: Vector
    truth: TrueTwist | None
    flow: FlowErrors | None
    quality: Quality
    note: str = ""
    tracks: TrackErrors | None = None
    static_flow: FlowErrors | None = None
    other_truths: tuple[TrueTwist | None, ...] = ()
    pose: NDArray[np.float64] | None = None
    gyro: str = ""
    relative_speed: float = float("nan")

    @property
    def t(self) -> int:
        """The window's middle, ns: the time that the velocities hold at."""
        return (self.t_start + self.t_end) // 2

    @property
    def ok(self) -> bool:
        """Whether the motion was measured."""
        return self.status == Status.OK

    @property
    def told(self) -> bool:
        """Whether a motion is told: measured, at rest, carried on or bounded."""
        return Status(self.status).told

    @property
    def translation_observable(self) -> bool:
        """Whether `linear` holds a direction."""
        return bool(np.isfinite(self.linear).all())

    @property
    def angular_error(self) -> Vector:
        """Estimated minus true angular velocity, (3,) rad/s; NaN where one is missing."""
        return self.angular - self.truth.angular if self.truth else np.full(3, np.nan)

    @property
    def axis_error_deg(self) -> float:
        """Angle between the axes of rotation; NaN below MIN_TRUE_RATE."""
        if self.truth is None or np.linalg.norm(self.truth.angular) < MIN_TRUE_RATE:
            return float("nan")
        return float(angle_deg(self.angular, self.truth.angular))

    @property
    def rate_ratio(self) -> float:
        """Estimated over true magnitude of angular velocity; NaN below MIN_TRUE_RATE."""
        if self.truth is None or np.linalg.norm(self.truth.angular) < MIN_TRUE_RATE:
            return float("nan")
        return float(np.linalg.norm(self.angular) / np.linalg.norm(self.truth.angular))

    @property
    def true_direction(self) -> Vector:
        """Unit direction of the true velocity, (3,); NaN where unknown or too slow."""
        linear = self.truth.linear if self.truth else None
        if linear is None or (speed := np.linalg.norm(linear)) < MIN_TRUE_SPEED:
            return np.full(3, np.nan)
        return np.asarray(linear / speed)

    @property
    def direction_error_deg(self) -> float:
        """Angle between the directions of linear velocity, sign included (0 to 180)."""
        return float(angle_deg(self.linear, self.true_direction))

    @property
    def scaled_linear_error(self) -> Vector:
        """Our direction times the true speed minus the true velocity, (3,) m/s: an oracle."""
        if self.truth is None or self.truth.linear is None:
            return np.full(3, np.nan)
        speed = np.linalg.norm(self.truth.linear)
        return np.asarray(speed * self.linear - self.truth.linear)

    @property
    def borrowed_linear_error(self) -> Vector:
        """The same with the sign of every axis taken from the truth, too, as the paper does."""
        if self.truth is None or self.truth.linear is None:
            return np.full(3, np.nan)
        speed = np.linalg.norm(self.truth.linear)
        borrowed = speed * np.abs(self.linear) * np.sign(self.truth.linear)
        return np.asarray(borrowed - self.truth.linear)

    def against(self, truth: TrueTwist | None) -> "WindowResult":
        """The same window, its velocities compared with another truth."""
        return replace(self, truth=truth)


def assess(
    index: int,
    window: Window,
    estimate: Estimate,
    truth: Truth,
    note: str = "",
    tracks: TrackErrors | None = None,
) -> WindowResult:
    """Compare one window's estimate with the truth, over the interval that is to be compared.

    The displacement is compared at the pixels that hold an event of the interval and whose truth
    is known (finite, |u| > 0 and |v| > 0), or at all whose truth is known; see TrueFlow.
    """
    part = compared_part(window)
    told = estimate.told
    observable = estimate.translation_observable
    variance = np.diag(estimate.covariance).astype(np.float64)
    flow, static_flow = _compare_flow(part, estimate, truth)
    t, linear, angular = estimate.t, estimate.linear, estimate.angular
    if part is not window and estimate.motion is not None:
        t = (part.t_start + part.t_end) // 2
        linear, angular = estimate.motion.linear(t), estimate.motion.angular(t)
    known = told & (variance >= 0) & ((np.arange(6) >= 3) | observable)
    return WindowResult(
        index=index,
        t_start=part.t_start,
        t_end=part.t_end,
        events=len(window.events),
        status=str(estimate.status),
        model=str(estimate.model),
        linear=np.where(observable, linear, np.nan),
        angular=np.where(told, angular, np.nan),
        sigma=np.sqrt(np.where(known, variance, np.nan)),
        truth=truth.twists.twist(t) if truth.twists else None,
        flow=flow,
        quality=estimate.quality,
        note=note,
        tracks=tracks,
        static_flow=static_flow,
        other_truths=tuple(source.twist(t) for source in truth.other_twists),
        pose=_true_pose(truth, t),
        gyro=str(estimate.gyro),
    )


def _true_pose(truth: Truth, t: int) -> NDArray[np.float64] | None:
    return truth.poses.transform(t) if truth.poses and truth.poses.covers(t) else None


def comparison_mask(window: Window, true_flow: TrueFlow) -> Mask:
    """Mark the pixels (H, W) that are compared."""
    if true_flow.everywhere:
        return true_flow.valid
    height, width = true_flow.valid.shape
    has_events = event_mask(window.events, width, height)
    return has_events & true_flow.valid & known_flow_mask(true_flow.displacement)


def _compare_flow(
    window: Window, estimate: Estimate, truth: Truth
) -> tuple[FlowErrors | None, FlowErrors | None]:
    """Compare all pixels, and those of the static scene where something else moves."""
    if estimate.flow is None or truth.flows is None:
        return None, None
    true_flow = truth.flows.displacement(window.t_start, window.t_end)
    if true_flow is None:
        return None, None
    mask = comparison_mask(window, true_flow)
    pixels, true = at_pixels(mask, true_flow.displacement)
    ours = estimate.flow.tracks(pixels, (window.t_start, window.t_end))[1] - pixels
    errors = flow_errors(ours, true)
    if true_flow.moving is None or not true_flow.moving.any():
        return errors, None
    static = ~true_flow.moving[mask]
    return errors, flow_errors(ours[static], true[static])
