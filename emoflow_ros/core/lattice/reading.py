"""What is reported of a fitted window: motion, flow, covariance and quality."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera_motion import SplineMotion, straight
from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice.field import LatticeFlow
from emoflow_ros.core.lattice.fit import FreeFlow, LatticeFit
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.uncertainty import PossibleMotions, without_translation
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Window
from emoflow_ros.core.types.gyro import GyroState, GyroStatus

Array = NDArray[np.float64]


class EstimateReader:
    """Reads estimates off one window's fit after another.

    Args:
        image: that the fit works on.
        epipolar: the lattice's constraint.
        fit: of the windows.
        config: of the estimator.
    """

    def __init__(
        self, image: WorkingImage, epipolar: NodeEpipolar, fit: LatticeFit, config: LatticeConfig
    ) -> None:
        self._image = image
        self._epipolar = epipolar
        self._fit = fit
        self._config = config

    def read(
        self, window: Window, free: FreeFlow, model: MotionModel, possible: PossibleMotions,
        agreement: float, quality: Quality, gyro: GyroStatus,
    ) -> Estimate:  # fmt: skip
        """Report a window that has been fitted.

        Args:
            window: its interval.
            free: the flow as the events alone see it.
            model: of the motion that was fitted.
            possible: motions that may explain the flow.
            agreement: of the scene with the sign of v, as `cheirality` tells it.
            quality: all but what is read off the fit here.
            gyro: whether a gyro took part.
        """
        fit = self._fit
        assert fit.motion is not None
        middle, present = fit.motion.at(0.5)
        w, v = _mean(middle, present, possible, model)
        covariance = self._covariance(window, free, possible, w, v)
        if self._config.model == "auto" and not possible.agree:
            model = MotionModel.ROTATION
        translates = model is not MotionModel.ROTATION
        front = float(np.copysign(1.0, agreement)) if translates else 0.0
        if fit.known is not None:
            w = w + fit.known.bend
        covariance[:3, 3:] *= front
        covariance[3:, :3] *= front
        motion = SplineMotion(
            window.t_start,
            window.t_end,
            straight(fit.motion.w + (w - middle)) / window.duration,
            front * straight(fit.motion.v + (v - present)),
        )
        return Estimate(
            window.t_start,
            window.t_end,
            (window.t_start + window.t_end) // 2,
            Status.OK,
            self._judge(quality, fit.motion),
            model,
            front * v,
            w / window.duration,
            covariance if translates else without_translation(covariance),
            LatticeFlow(
                *self._image.on_sensor(fit.lattice, fit.flow), window.t_start, window.t_end
            ),
            motion,
            gyro,
        )

    def _covariance(
        self, window: Window, free: FreeFlow, possible: PossibleMotions, w: Array, v: Array
    ) -> Array:
        """Covariance (6, 6) of (v, w), rad/s, with v across its direction."""
        epipolar = self._epipolar
        flow = self._fit.node_flow.mean(axis=1)
        evidence = epipolar.usable * np.trace(self._fit.evidence, axis1=1, axis2=2)
        squares = ((flow - epipolar.b @ w) ** 2).sum(axis=-1)
        parallax = float(np.sqrt(evidence @ squares / max(float(evidence.sum()), 1e-9)))
        known = None if free.known is None else free.known[1]
        covariance = possible.covariance(parallax, epipolar.px_per_rad, known)
        across = np.zeros((6, 6))
        across[:3, 3:] = np.eye(3) - np.outer(v, v)
        across[3:, :3] = np.eye(3) / window.duration
        covariance = across @ covariance @ across.T
        return np.asarray(0.5 * (covariance + covariance.T))

    def rotation_of_events(self, free: FreeFlow) -> tuple[Array, Array]:
        """Tell the angular velocity without the gyro, for the gyro to learn from.

        Args:
            free: the flow as the events alone see it.

        Returns:
            w (3,) in the middle of the window and its covariance (3, 3), rad per window.
        """
        fit, epipolar = self._fit, self._epipolar
        assert fit.motion is not None
        v = fit.motion.at(0.5)[1]
        here = epipolar.score(v, *free.seen, sized=False)
        others = epipolar.search(*free.seen, sized=False)
        rotation = epipolar.rotation(*free.seen, sized=False)
        w, possible = here.w[0], PossibleMotions.weigh((here.w[0], v), here, others, rotation)
        if self._config.model == MotionModel.ROTATION:
            w, possible = rotation.w[0], PossibleMotions(np.zeros(6), np.zeros((6, 6)))
        covariance = possible.covariance(1.0, epipolar.px_per_rad)[:3, :3]
        bend = 0.0 if fit.known is None else fit.known.bend
        return w + possible.mean[:3] + bend, covariance

    def _judge(self, quality: Quality, motion: Motion) -> Quality:
        """Add residuals of the epipolar constraint."""
        residual = self._epipolar.residuals(self._fit.node_flow, motion).r[self._epipolar.usable]
        scale = 1.4826 * float(np.median(np.abs(residual)))
        inliers = float(np.mean(np.abs(residual) <= 3 * scale))
        return replace(
            quality,
            residual_px=scale * float(self._image.sensor_px.max()),
            inlier_fraction=inliers,
        )


def _mean(w: Array, v: Array, possible: PossibleMotions, model: MotionModel) -> tuple[Array, Array]:
    """Mean over the possible motions, (w, v), from the present one; what the model fixes stays."""
    if model is MotionModel.FULL:
        w = w + possible.mean[:3]
    if model is not MotionModel.ROTATION:
        v = v + possible.mean[3:]
    return w, v / np.linalg.norm(v)


def with_gyro(
    estimate: Estimate, measurement: GyroMeasurement | None, config: LatticeConfig
) -> Estimate:
    """Let a gyro tell w, and the events v.

    What the events know of w is in the gyro's bias by then: counted again in every window they
    would make w too sure, and no better. Where the events give nothing, the gyro alone tells w. A
    camera that is known not to rotate needs no gyro.

    Args:
        estimate: of a window, by its events.
        measurement: of the gyro over the window; None without one.
        config: of the estimator.
    """
    used = estimate.gyro.state is GyroState.USED  # the events may just have refuted it
    if measurement is None or not used or config.model == MotionModel.TRANSLATION:
        return estimate
    covariance = estimate.covariance.copy()
    covariance[3:, 3:] = measurement.middle_covariance
    points = measurement.control_points()
    linear = np.zeros_like(points)
    found = replace(estimate, status=Status.OK, angular=measurement.middle, covariance=covariance)
    if estimate.status is not Status.OK:
        found = replace(
            found,
            model=MotionModel.ROTATION,
            linear=np.zeros(3),
            covariance=without_translation(covariance),
        )
    elif isinstance(estimate.motion, SplineMotion):
        linear = estimate.motion.linear_points
    return replace(found, motion=SplineMotion(found.t_start, found.t_end, points, linear))
