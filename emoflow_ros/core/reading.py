"""What is reported of a fitted window: motion, flow, covariance and quality."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.belief import Belief
from emoflow_ros.core.camera_motion import SplineMotion
from emoflow_ros.core.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Window
from emoflow_ros.core.gyro_checks import GyroStatus
from emoflow_ros.core.lattice import LatticeFlow
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.lattice_fit import FreeFlow, LatticeFit
from emoflow_ros.core.preparation import WorkingImage
from emoflow_ros.core.second_look import probability_of_failure
from emoflow_ros.core.selection import ModelSelector
from emoflow_ros.core.uncertainty import MotionUncertainty, without_travel

Array = NDArray[np.float64]


class EstimateReader:
    """Reads estimates off one window's fit after another.

    Args:
        image: that the fit works on.
        epipolar: the lattice's constraint.
        fit: of the windows.
        config: of the estimator.

    Attributes:
        uncertainty: of the egomotion.
    """

    def __init__(
        self, image: WorkingImage, epipolar: NodeEpipolar, fit: LatticeFit, config: LatticeConfig
    ) -> None:
        self.uncertainty = MotionUncertainty(fit.lattice, epipolar)
        self._image = image
        self._epipolar = epipolar
        self._fit = fit
        self._config = config

    def read(
        self, window: Window, belief: Belief, selector: ModelSelector, quality: Quality,
        gyro: GyroStatus,
    ) -> Estimate:  # fmt: skip
        """Report a window that has been fitted.

        Args:
            window: its interval.
            belief: what the fit says of (w, v) in its middle.
            selector: which model the evidence speaks for.
            quality: all but what is read off the fit here.
            gyro: whether a gyro took part.
        """
        fit = self._fit
        assert fit.motion is not None
        model = selector.model
        w, v = fit.motion.at(0.5)
        rotation = self._rotation(w, model)
        evidence = self._epipolar.usable * np.trace(fit.evidence, axis1=1, axis2=2)
        jump = self.uncertainty.jump_of(rotation / window.duration)
        covariance = self._covariance(belief, jump, evidence, window, model)
        travels = model is not MotionModel.ROTATION
        front = np.copysign(1.0, selector.agreement) if travels else 0.0
        if self._config.model == "auto" and not self.uncertainty.claims(front * v) and travels:
            model, front = MotionModel.ROTATION, 0.0
            covariance = without_travel(covariance)
        lattice, field = self._image.on_sensor(fit.lattice, fit.flow)
        motion = SplineMotion(
            window.t_start,
            window.t_end,
            (fit.motion.w + (rotation - w)) / window.duration,
            front * fit.motion.v,
        )
        return Estimate(
            window.t_start,
            window.t_end,
            belief.t,
            Status.OK,
            self._judge(quality, fit.motion),
            model,
            front * v,
            rotation / window.duration,
            covariance,
            LatticeFlow(lattice, field, window.t_start, window.t_end),
            motion,
            gyro,
        )

    def rotation_of_events(self, free: FreeFlow, model: MotionModel) -> tuple[Array, Array]:
        """Tell the angular velocity without the gyro, for the gyro to learn from.

        Args:
            free: the flow as the events alone see it.
            model: of the motion.

        Returns:
            w (3,) in the middle of the window and its covariance (3, 3), rad per window.
        """
        fit = self._fit
        assert fit.motion is not None
        v = fit.motion.at(0.5)[1] if model is not MotionModel.ROTATION else None
        w, covariance = self.uncertainty.of_events(free.flow, free.information, v)
        return (w if fit.known is None else w + fit.known.bend), covariance

    def _rotation(self, w: Array, model: MotionModel) -> Array:
        """Mean (3,) of the possible angular velocities in the middle, rad per window."""
        rotation = w if self._fit.known is None else w + self._fit.known.bend
        if model is MotionModel.FULL:
            rotation = rotation + self.uncertainty.mean_rotation
        return rotation

    def _covariance(
        self, belief: Belief, jump: float, evidence: Array, window: Window, model: MotionModel
    ) -> Array:
        if self._config.model == "translation":
            return belief.across()  # that the camera does not turn is known
        fit, uncertainty = self._fit, self.uncertainty
        turns = model is MotionModel.ROTATION
        covariance_of = uncertainty.of_rotation if turns else uncertainty.of_travel
        flow = fit.node_flow.mean(axis=1)
        covariance = covariance_of(belief, flow, fit.evidence, window.duration, fit.known)
        if fit.known is not None:
            return covariance if turns else uncertainty.with_gyro(covariance)
        return uncertainty.calibrated(covariance, jump, evidence)

    def _judge(self, quality: Quality, motion: Motion) -> Quality:
        """Add residuals of the epipolar constraint and the probability of failure."""
        residual = self._epipolar.residuals(self._fit.node_flow, motion).r[self._epipolar.usable]
        scale = 1.4826 * float(np.median(np.abs(residual)))
        inliers = float(np.mean(np.abs(residual) <= 3 * scale))
        judged = replace(
            quality,
            residual_px=scale * float(self._image.sensor_px.max()),
            inlier_fraction=inliers,
        )
        return replace(judged, doubt=probability_of_failure(quality.second_look_px))
