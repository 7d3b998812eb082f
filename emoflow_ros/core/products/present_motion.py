"""The latest twist, from the newest events and the scene that the last window has shown.

A window's estimate holds at its middle, and comes after its last event by the time that it takes to
compute. The scene's flow hardly changes in that time, apart from what the camera's change of motion
makes of it: that is six numbers (`known_scene`), for which a short slice of events is enough.
The contrast of the slice's events decides on w and v together with what is expected: what the slice
before has shown, and the window's estimate, carried on by its own change of w and a random walk, or
by a gyro. Slices overlap, so that of their information the new events' share counts. How fast the
image moves by the newest events bounds it (`gauge`): a camera that stops is at rest at once.
Later windows tell how wrong the latest twists were (`hindsight`).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.gyro.checks import FreezeWatch
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.preparation import WorkingImage, prepare
from emoflow_ros.core.lattice.uncertainty import without_translation
from emoflow_ros.core.products.hindsight import Hindsight
from emoflow_ros.core.products.known_scene import KnownScene, inverse_depths, motion_covariance
from emoflow_ros.core.products.motion_prior import HeldMotion, Known
from emoflow_ros.core.products.present_scene import Change, SeenScene, measured
from emoflow_ros.core.products.settings import PRESENT, STREAM
from emoflow_ros.core.stream.cleaning import clean
from emoflow_ros.core.types.estimate import Estimate, FlowSampler, SpeedBound, Status, velocity_at
from emoflow_ros.core.types.events import NS_PER_S, Window
from emoflow_ros.core.types.gyro import GyroReadings, GyroState
from emoflow_ros.core.types.twist import PresentTwist, Twist

Array = NDArray[np.float64]


class PresentMotion:
    """Estimates the latest twist between the estimates of windows.

    It depends on the windows' estimates and on the slices so far.

    Args:
        camera: with its lens.
        config: of the estimator of the windows.
    """

    def __init__(self, camera: Camera, config: LatticeConfig) -> None:
        self._config = replace(config, min_events=PRESENT.fewest_events, max_events=PRESENT.events)
        self._image = WorkingImage.of(camera)
        self._lattice = Lattice.with_spacing(*self._image.camera.size, config.spacing_px)
        self._epipolar = NodeEpipolar(self._image.camera, self._lattice, config.dec_inlier_px)
        self._contrast = Contrast(self._lattice, 1.0)
        self._drift = np.radians(np.repeat([config.angular_drift, config.direction_drift], 3)) ** 2
        self._scene: SeenScene | None = None
        self._hindsight = Hindsight()
        self._before: Change | None = None  # what the last slice has shown

    def know(self, estimate: Estimate, gyro: GyroReadings | None = None) -> None:
        """Take a window's estimate. After one that cannot be used there is no latest twist.

        Args:
            estimate: of the window.
            gyro: its readings.
        """
        self._scene = None
        if estimate.told:
            self._scene = self._see(estimate, gyro)
        if self._scene is None or self._scene.known is None:  # the camera stops, or who knows
            self._before = None
        self._hindsight.learn(estimate)

    def estimate(self, window: Window) -> PresentTwist | None:
        """Estimate the motion at the end of a slice of events.

        After a window without a flow, and with too few events for a fit, the gyro carries the
        motion on, or a random walk does.

        Args:
            window: the newest SLICE_MS of the events. Where fast motion has made the estimate's
                window shorter, only so much of it is fitted.

        Returns:
            None without a motion of the last 600 ms to start from.
        """
        scene = self._scene
        if scene is None or not scene.t < window.t_end <= scene.valid_until:
            return None
        seen = clean(window, self._image.sensor)
        part = seen.since(window.t_end - scene.length_ns)
        middle = (part.t_start + part.t_end) // 2
        gyro = None if _is_frozen(window) else window.gyro
        by_gyro = scene.change_by_gyro(gyro, middle)
        if scene.known is None and not _is_fresh(window):
            by_gyro = None
        before, share = self._before, 1.0
        if by_gyro is not None or before is None or before.t >= middle:  # also where time goes back
            before = self._before = None
        else:
            share = min(1.0, (middle - before.t) / NS_PER_S / part.duration)
        expected = scene.expected(middle, before)
        if by_gyro is not None:
            expected = expected.by_gyro(*by_gyro)
        tells = by_gyro is None or scene.translates  # the events add nothing to a gyro's w
        shown = self._fit(expected, part, share) if tells else None
        change, at_end = shown or expected, None
        if by_gyro is not None:
            change, at_end = change.by_gyro(*by_gyro), scene.change_by_gyro(gyro, window.t_end)
        told = _at_end(change, window.t_end, by_gyro, at_end, fitted=shown is not None)
        found = _read(window.t_end, scene, *told)
        if found is None:
            return None
        if by_gyro is None and shown is not None:
            self._before, found = shown, self._hindsight.scaled(found)
        own = scene.measured and (shown is not None or scene.known is None)
        return _held(scene.bound, seen, found, measured=own, by_gyro=by_gyro is not None)

    def _fit(self, expected: Change, part: Window, share: float) -> Change | None:
        """Fit an expected change to events of a slice; None if that cannot be done.

        Args:
            expected: until the slice's middle.
            part: the slice.
            share: of its time that no other slice had.
        """
        scene = expected.scene
        if scene.known is None:
            return None
        events = prepare(part, self._image, self._config)
        if events is None:
            return None
        free = 6 if scene.translates else 3
        mean, covariance = expected.mean.copy(), expected.covariance.copy()
        try:
            mean[:free], covariance[:free, :free] = scene.known.fit(
                self._contrast, events, part.duration, share,
                (mean[:free], covariance[:free, :free]),
            )  # fmt: skip
        except np.linalg.LinAlgError:
            return None
        return replace(expected, mean=mean, covariance=covariance)

    def _see(self, estimate: Estimate, gyro: GyroReadings | None) -> SeenScene:
        motion, length = estimate.motion, estimate.t_end - estimate.t_start
        assert motion is not None
        own = estimate.status is Status.OK
        t = max(estimate.t, estimate.t_end - PRESENT.mean_ns) if own else estimate.t
        w, v = motion.angular(t), motion.linear(t)
        change = motion.angular(estimate.t_end) - motion.angular(estimate.t_start)
        fitted = motion.motion if isinstance(motion, HeldMotion) else motion  # near the flow's
        known = None
        if estimate.flow is not None:
            known = self._shown(estimate.flow, t, fitted.angular(t), v)
        drift, walk = self._drift.copy(), estimate.angular_walk
        drift[3:] *= PRESENT.of_direction
        if walk is not None:
            drift[:3] = PRESENT.of_walk * walk
        used = estimate.gyro.state is GyroState.USED
        return SeenScene(
            t=t,
            valid_until=estimate.t + PRESENT.longest_ns,
            length_ns=length,
            motion=np.concatenate([w, v]),
            angular_acceleration=change * (NS_PER_S / length),
            covariance=motion_covariance(estimate, v),
            drift=drift,
            known=known,
            translates=estimate.translation_observable,
            gyro=measured(gyro, t) if used else None,
            bound=estimate.bound,
            measured=own,
        )

    def _shown(self, flow: FlowSampler, t: int, w: Array, v: Array) -> KnownScene:
        """Take the scene from a flow and the motion (w, v) at time t, ns."""
        epipolar, image = self._epipolar, self._image
        points = self._lattice.pixels * image.sensor_px
        rate = velocity_at(flow, points, t) / image.sensor_px
        return KnownScene.at_depths(epipolar, rate, inverse_depths(epipolar, rate, w, v))


def _at_end(
    change: Change, t: int, by_gyro: tuple[Array, float] | None, at_end: tuple[Array, float] | None,
    *, fitted: bool,
) -> tuple[Array, Array]:  # fmt: skip
    """Motion (6,) and its covariance (6, 6) at a slice's end.

    The slice shows the change alone: what the window took for the motion stays.

    Args:
        change: until the slice's middle.
        t: the slice's end, ns.
        by_gyro, at_end: what a gyro tells of the change until middle and end, with its variance;
            None if it does not.
        fitted: whether the slice's events told.
    """
    scene, rest = change.scene, (t - change.t) / NS_PER_S
    mean, covariance = change.carried_on(t).mean, scene.covariance + change.covariance
    walk = scene.drift * rest
    if by_gyro is not None and at_end is not None:
        mean[:3] = change.mean[:3] + at_end[0] - by_gyro[0]
        # of readings that end before now
        walk[:3] = max(0.0, at_end[1] - by_gyro[1] - PRESENT.live_gap)
    elif by_gyro is not None:  # its readings end before now
        walk[:3] += _goes_on(change, rest)
    elif fitted:
        walk[:3] = _goes_on(change, rest)
        covariance[:3], covariance[:, :3] = 0.0, 0.0
        covariance[:3, :3] = scene.covariance[:3, :3] + PRESENT.of_fit * change.covariance[:3, :3]
    return scene.motion + mean, covariance + np.diag(walk)


def _goes_on(change: Change, rest: float) -> float:
    """Variance of a random walk that goes on: a camera that shakes does, a calm one stays.

    Args:
        change: how far its w is from what the window foresees tells how fast the walk is.
        rest: time for which nothing is known, s.
    """
    scene = change.scene
    surprise = change.mean[:3] - scene.predicted_change(change.t)
    since = max((change.t - scene.t) / NS_PER_S, PRESENT.least_since_s)
    rate = float(surprise @ surprise) / 3 / since
    return (rate + PRESENT.of_drift * float(scene.drift[0])) * rest


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
    return len(readings) > 0 and window.t_end - int(readings.t[-1]) <= PRESENT.gyro_fresh_ns


def _held(
    bound: SpeedBound | None, seen: Window, found: PresentTwist, *, measured: bool, by_gyro: bool
) -> PresentTwist:
    """Hold a motion against how fast the newest events let the image move.

    What was not measured is held against it always. A motion that was measured is by far faster
    than the events only where the camera has stopped, or slowed down, since.

    Args:
        bound: of the speed, or None.
        seen: the newest events.
        found: the motion.
        measured: whether events told it.
        by_gyro: whether a gyro told its w, which is left alone.
    """
    if bound is None:
        return found
    parts = (seen, seen.since(seen.t_end - PRESENT.newest_ns))
    speeds = [speed for speed in map(bound.speed, parts) if speed is not None]
    if not speeds:
        return found
    speed, twist = min(speeds), found.twist
    of_rest = bound.rotation_covariance(speed)
    motion = Known(twist.t, twist.linear, twist.angular, found.covariance)
    too_fast = float(twist.angular @ np.linalg.solve(of_rest, twist.angular)) > PRESENT.too_fast**2
    if not by_gyro and (too_fast or not measured):
        if measured:  # all of it may be of before
            covariance = motion.covariance.copy()
            covariance[3:, 3:] += np.outer(twist.angular, twist.angular)
            motion = replace(motion, covariance=covariance)
        motion = motion.held_against(of_rest)
    if speed <= STREAM.rest_px_s:
        covariance = bound.rest_covariance(speed)
        covariance[3:, 3:] = motion.covariance[3:, 3:]
        motion = Known(twist.t, np.zeros(3), motion.angular, covariance)
    return PresentTwist(Twist(twist.t, motion.linear, motion.angular), motion.covariance)


def _read(t: int, scene: SeenScene, motion: Array, covariance: Array) -> PresentTwist | None:
    w, v = np.split(motion, 2)
    length = float(np.linalg.norm(v))
    direction = v / length if scene.translates and length > 0 else np.zeros(3)
    across = np.eye(6)
    if scene.translates and length > 0:
        across[3:, 3:] = (np.eye(3) - np.outer(direction, direction)) / length
    order = np.r_[3:6, 0:3]
    of_twist = (across @ covariance @ across.T)[np.ix_(order, order)]
    if not scene.translates:
        of_twist = without_translation(of_twist)
    if not (np.isfinite(w).all() and np.isfinite(of_twist).all()):
        return None
    return PresentTwist(Twist(t, direction, w), 0.5 * (of_twist + of_twist.T))
