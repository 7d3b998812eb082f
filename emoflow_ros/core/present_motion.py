"""The motion of now, from the newest events and the scene that the last window has shown.

A window's estimate holds at its middle, and comes after its last event by the time that it takes to
compute. The scene's flow hardly changes in that time, apart from what the camera's change of motion
makes of it: that is six numbers (core.earlier_scene), for which a short slice of events is enough.
The contrast of the slice's events and the window's estimate decide on w and v together. The
estimate is carried on by the window's own change of w and a random walk, or by a gyro.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.earlier_scene import KnownScene, inverse_depths, motion_covariance
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate, FlowSampler, PresentTwist, Status, Twist
from emoflow_ros.core.events import NS_PER_MS, NS_PER_S, Window
from emoflow_ros.core.gyro_checks import FreezeWatch, GyroState
from emoflow_ros.core.gyro_measurement import GyroReadings, Shape, fit_shape
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.preparation import WorkingImage, clean, prepare
from emoflow_ros.core.uncertainty import without_travel

Array = NDArray[np.float64]

_LONGEST_NS = 600 * NS_PER_MS  # from the middle of the last window to now
_EVENTS = 8_000  # are enough for six numbers
_FEWEST_EVENTS = 300
_STEPS = ((0.5, 2),)  # scale and steps: wide maxima, for the motion may have changed much
_FLOW_STEP_NS = NS_PER_MS  # over which the window's flow is measured
_MEAN_NS = 5 * NS_PER_MS  # on either side of a time, against the noise of single gyro readings
# Largest age of the newest reading where the gyro alone tells the motion.
_GYRO_FRESH_NS = 20 * NS_PER_MS
# Variance of the change of w that was not predicted over its square: the scene has moved since, and
# its depths are not exact.
_CHANGE_ERROR = 0.2
_EXPECTED_DRIFT = 0.15  # of the configured one: what most recordings show
_LEAST_SINCE_S = 0.01  # over which a change tells of the drift
# Time in which an angular acceleration becomes smaller by a factor of e: this, or the window's
# length if that is shorter, for the change within a short window is known less well.
_FADES_S = 0.06
_GYRO_ERROR = np.radians(0.5)  # rad/s, of a difference of two such means
_LIVE_GAP = 0.025**2  # (rad/s)^2, variance of the gap where readings end at the mean's middle


@dataclass(frozen=True)
class _Scene:
    """What a window has shown near its end.

    Attributes:
        t: the time that motion and scene hold at, ns.
        valid_until: the last time that it tells of, ns.
        length_ns: of the window.
        motion: (6,) w in rad/s and the unit direction v.
        angular_acceleration: (3,) mean over the window, rad/s^2.
        covariance: (6, 6) of the motion.
        known: the scene; None where the window had no flow.
        travels: whether v is known.
        gyro: what the gyro measures around t, or None.
    """

    t: int
    valid_until: int
    length_ns: int
    motion: Array
    angular_acceleration: Array
    covariance: Array
    known: KnownScene | None
    travels: bool
    gyro: Shape | None

    def predicted_change(self, t: int) -> Array:
        """Change of w (3,) from the scene's time to t, ns: as in the window, but it fades."""
        ahead, fades = (t - self.t) / NS_PER_S, min(_FADES_S, self.length_ns / NS_PER_S)
        seconds = -fades * np.expm1(-ahead / fades) if ahead > 0 else ahead
        return self.angular_acceleration * seconds

    def change_by_gyro(self, gyro: GyroReadings | None, t: int) -> tuple[Array, float] | None:
        """Change of w (3,) since the scene was seen as a gyro tells it, bias and all.

        Returns:
            The change, rad/s, and its variance in each axis. None without readings.
        """
        now = _measured(gyro, t)
        if now is None or self.gyro is None:
            return None
        change = now.coefficients[0] - self.gyro.coefficients[0]
        return change, _GYRO_ERROR**2 + now.gap_variance + self.gyro.gap_variance


class PresentMotion:
    """Estimates the motion of now between the estimates of windows.

    It depends on the last estimate and on the slice's own events alone.

    Args:
        camera: with its lens.
        config: of the estimator of the windows.
    """

    def __init__(self, camera: Camera, config: LatticeConfig) -> None:
        self._config = replace(config, min_events=_FEWEST_EVENTS, max_events=_EVENTS)
        self._image = WorkingImage.of(camera)
        self._lattice = Lattice.with_spacing(*self._image.camera.size, config.spacing_px)
        self._epipolar = NodeEpipolar(self._image.camera, self._lattice, config.dec_inlier_px)
        self._contrasts = {scale: Contrast(self._lattice, scale) for scale, _ in _STEPS}
        self._drift = np.radians(np.repeat([config.angular_drift, config.direction_drift], 3)) ** 2
        self._scene: _Scene | None = None

    def know(self, estimate: Estimate, gyro: GyroReadings | None = None) -> None:
        """Take a window's estimate. After one that cannot be used there is no motion of now.

        Args:
            estimate: of the window.
            gyro: its readings.
        """
        self._scene = None
        if estimate.status is Status.OK:
            self._scene = self._see(estimate, gyro)

    def estimate(self, window: Window) -> PresentTwist | None:
        """Estimate the motion at the end of a slice of events.

        After a window without a flow (doubtful, or by the gyro alone) the gyro carries its motion
        on.

        Args:
            window: the newest SLICE_MS of the events. Where fast motion has made the estimate's
                window shorter, only so much of it is used.

        Returns:
            None without an estimate of the last 600 ms to start from, and with too few events or,
            after a window without a flow, without readings of the gyro from the last 20 ms.
        """
        scene = self._scene
        if scene is None or not scene.t < window.t_end <= scene.valid_until:
            return None
        part = clean(window, self._image.sensor).since(window.t_end - scene.length_ns)
        middle = (part.t_start + part.t_end) // 2
        gyro = None if _is_frozen(window) else window.gyro
        by_gyro = scene.change_by_gyro(gyro, middle)
        drift, expected = self._drift.copy(), np.zeros(6)
        since = max(0, middle - scene.t) / NS_PER_S
        if by_gyro is None:
            expected[:3], variance = scene.predicted_change(middle), 0.0
        else:
            expected[:3], variance = by_gyro
            drift[:3] = 0.0
        covariance = scene.covariance + np.diag(drift * since)
        covariance[:3, :3] += variance * np.eye(3)
        change = expected.copy()
        if scene.known is not None:
            if not self._fit(scene.known, part, change, covariance, 6 if scene.travels else 3):
                return None
        elif by_gyro is None or not _is_fresh(window):
            return None
        at_end = scene.change_by_gyro(gyro, window.t_end)
        if by_gyro is not None and at_end is not None:
            change[:3] += at_end[0] - by_gyro[0]
            late = max(0.0, at_end[1] - by_gyro[1] - _LIVE_GAP)  # of readings that end before now
            covariance[:3, :3] += late * np.eye(3)
        else:
            surprise = change[:3] - expected[:3]
            unforeseen = change[:3] - scene.predicted_change(middle)
            change[:3] += scene.predicted_change(window.t_end) - scene.predicted_change(middle)
            drift[:3] = _drift_by(self._drift[0], unforeseen, max(since, _LEAST_SINCE_S))
            covariance[:3, :3] += _CHANGE_ERROR * float(surprise @ surprise) / 3 * np.eye(3)
        covariance += np.diag(drift * (window.t_end - middle) / NS_PER_S)
        return _read(window.t_end, scene, change, covariance)

    def _fit(
        self, known: KnownScene, part: Window, change: Array, covariance: Array, free: int
    ) -> bool:
        """Fit the first `free` numbers of the change (6,) to events; False if that cannot be done.

        The change as predicted and its covariance (6, 6) are replaced by those that follow.
        """
        events = prepare(part, self._image, self._config)
        if events is None:
            return False
        try:
            prior = change[:free].copy(), np.linalg.inv(covariance[:free, :free])
            change[:free], information = known.fit(
                self._contrasts, _STEPS, events, part.duration, prior
            )
            covariance[:free, :free] = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return False
        return True

    def _see(self, estimate: Estimate, gyro: GyroReadings | None) -> _Scene:
        motion, length = estimate.motion, estimate.t_end - estimate.t_start
        assert motion is not None
        t = max(estimate.t, estimate.t_end - _MEAN_NS)
        w, v = motion.angular(t), motion.linear(t)
        change = motion.angular(estimate.t_end) - motion.angular(estimate.t_start)
        known = None if estimate.flow is None else self._shown(estimate.flow, t, w, v)
        used = estimate.gyro.state is GyroState.USED
        return _Scene(
            t=t,
            valid_until=estimate.t + _LONGEST_NS,
            length_ns=length,
            motion=np.concatenate([w, v]),
            angular_acceleration=change * (NS_PER_S / length),
            covariance=motion_covariance(estimate, v),
            known=known,
            travels=estimate.translation_observable,
            gyro=_measured(gyro, t) if used else None,
        )

    def _shown(self, flow: FlowSampler, t: int, w: Array, v: Array) -> KnownScene:
        """Take the scene from a flow and the motion (w, v) at time t, ns."""
        epipolar, image = self._epipolar, self._image
        points = self._lattice.pixels * image.sensor_px
        moved = flow.tracks(points, [t, t + _FLOW_STEP_NS])[1] - points
        rate = moved / image.sensor_px * (NS_PER_S / _FLOW_STEP_NS)
        return KnownScene.at_depths(epipolar, rate, inverse_depths(epipolar, rate, w, v))


def _drift_by(configured: float, unforeseen: Array, seconds: float) -> float:
    """Drift of w, (rad/s)^2 per second, by what its change in the last `seconds` was off by.

    "Off" is the change (3,) less that which the window predicts.
    The mean of an expected value, which counts as much as one such change, and the change's own: a
    camera that shakes goes on shaking, and a calm one stays calm.
    """
    expected = _EXPECTED_DRIFT**2 * configured
    return 0.5 * (expected + float(unforeseen @ unforeseen) / (3 * seconds))


def _is_frozen(window: Window) -> bool:
    """Tell whether the gyro of a slice repeats its last reading, which tells nothing."""
    if window.gyro is None:
        return False
    watch = FreezeWatch()
    watch.take(window.gyro.covering(window.t_start, window.t_end, 0))
    return watch.until is not None


def _is_fresh(window: Window) -> bool:
    """Tell whether the gyro was read lately enough to carry the motion on alone."""
    if window.gyro is None:
        return False
    readings = window.gyro.covering(window.t_start, window.t_end, 0)
    return len(readings) > 0 and window.t_end - int(readings.t[-1]) <= _GYRO_FRESH_NS


def _measured(gyro: GyroReadings | None, t: int) -> Shape | None:
    """What a gyro's readings tell around a time; None if they are not there or not finite."""
    if gyro is None:
        return None
    start, end = t - _MEAN_NS, t + _MEAN_NS
    near = gyro.covering(start, end)
    if len(near) == 0 or not np.isfinite(near.w).all():
        return None
    return fit_shape(near, start, end)


def _read(t: int, scene: _Scene, change: Array, covariance: Array) -> PresentTwist | None:
    w, v = np.split(scene.motion + change, 2)
    length = float(np.linalg.norm(v))
    direction = v / length if scene.travels and length > 0 else np.zeros(3)
    across = np.eye(6)
    if scene.travels and length > 0:
        across[3:, 3:] = (np.eye(3) - np.outer(direction, direction)) / length
    order = np.r_[3:6, 0:3]
    of_twist = (across @ covariance @ across.T)[np.ix_(order, order)]
    if not scene.travels:
        of_twist = without_travel(of_twist)
    if not (np.isfinite(w).all() and np.isfinite(of_twist).all()):
        return None
    return PresentTwist(Twist(t, direction, w), 0.5 * (of_twist + of_twist.T))
