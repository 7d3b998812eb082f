"""The lattice of the real-time estimator: a warm-started fit of flow and motion per window."""

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import cheirality
from emoflow_ros.core.gyro.config import GyroConfig
from emoflow_ros.core.gyro.gyro import Gyro
from emoflow_ros.core.gyro.measurement import GyroMeasurement
from emoflow_ros.core.lattice.blending import Blend
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.confinement import is_confined
from emoflow_ros.core.lattice.contrast import contrast_gain
from emoflow_ros.core.lattice.egomotion import Motion, NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.lattice.fit import FreeFlow, LatticeFit
from emoflow_ros.core.lattice.flow_starts import best_start, cold_start, fresh_start, is_lost
from emoflow_ros.core.lattice.known import KnownRotation
from emoflow_ros.core.lattice.memory import Memory
from emoflow_ros.core.lattice.motion_windows import MotionChange
from emoflow_ros.core.lattice.preparation import WorkingImage, prepare
from emoflow_ros.core.lattice.reading import EstimateReader, with_gyro
from emoflow_ros.core.lattice.refinement import Depths, ShownFlow, refined
from emoflow_ros.core.lattice.selection import rotates
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.uncertainty import PossibleMotions, temperature
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import Window

Array = NDArray[np.float64]


class LatticeEstimator:
    """Fits flow and egomotion to one window after another (an Estimator).

    Args:
        camera: with its lens.
        config: see LatticeConfig.
        gyro: whose readings the windows bring.
        whole: whether windows are always taken whole; else of one whose motion changes more than a
            fit can follow only the latest part is told, unless it starts cold or brings a gyro.
    """

    def __init__(
        self, camera: Camera, config: LatticeConfig, gyro: Gyro | None = None, *,
        whole: bool = True,
    ) -> None:  # fmt: skip
        self.config = config
        self._whole = whole
        self._image = WorkingImage.of(camera)
        self.lattice = Lattice.with_spacing(*self._image.camera.size, config.spacing_px)
        self._epipolar = NodeEpipolar(self._image.camera, self.lattice, config.dec_inlier_px)
        self._fit = LatticeFit(self.lattice, self._epipolar, config)
        self._blend = Blend(self._image.camera, self.lattice, config.depth_drift)
        self._change = MotionChange(self._fit.contrasts[0.25])
        self._reader = EstimateReader(self._image, self._epipolar, self._fit, config)
        self._gyro = gyro or Gyro(GyroConfig())
        # The systems are small: threads of the linear algebra library would only spin.
        self._threads = ThreadpoolController()
        self._events = WindowEvents(*np.zeros((4, 0), np.float32))
        self.reset()

    def reset(self) -> None:
        """Forget previous windows: the next one starts cold."""
        self._last: Memory | None = None
        fixed = self.config.model
        self._model = MotionModel.FULL if fixed == "auto" else MotionModel(fixed)

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to one window."""
        measurement = self._gyro.measure(window.t_start, window.t_end, window.gyro)
        self._started = time.perf_counter()
        with self._threads.limit(limits=1, user_api="blas"):
            found = self._estimate(window, measurement, whole=self._whole)
        return with_gyro(found, measurement, self.config)

    def refined(self, estimate: Estimate, depths: Depths) -> tuple[Estimate, ShownFlow | None]:
        """Fit the last window's flow again, for the next to start from, or take a rigid scene's.

        Args:
            estimate: of the window, with a motion.
            depths: of the scene, at points on the sensor.

        Returns:
            The estimate with that flow, and what it shows of the scene.
        """
        depths = replace(depths, points=depths.points / self._image.sensor_px)
        blend, events = self._blend, self._events
        with self._threads.limit(limits=1, user_api="blas"):
            begin, structure = self._fit.flow, None
            rigid = blend.rigid(events, estimate, depths)
            if rigid is not None:
                begin, structure = blend.start(events, begin, rigid), rigid.structure
            found = refined(self._fit, begin, events, estimate, structure)
            if found is not None and self._last is not None:  # the next window starts from it
                self._last = replace(self._last, flow=found.flow)
            if rigid is not None and found is not None:
                lattice, flow = blend.fine, blend(events, found.flow, rigid)
            elif rigid is not None and estimate.flow is None:
                lattice, flow = blend.fine, rigid.flow.astype(np.float32)
            elif found is not None:
                lattice, flow = self.lattice, found.flow
            else:
                return estimate, None
        told = LatticeFlow(*self._image.on_sensor(lattice, flow), estimate.t_start, estimate.t_end)
        return replace(estimate, flow=told), found and found.shown

    def _estimate(
        self, window: Window, measurement: GyroMeasurement | None, *, whole: bool
    ) -> Estimate:
        self._iterations = 0
        events = prepare(window, self._image, self.config)
        if events is None:
            return self._nothing(window, 0, Status.TOO_FEW_EVENTS)
        fit, last, self._events = self._fit, self._last, events
        if last is None or not last.reaches(window):
            last = Memory.expected(window, fit, self._image.sensor_px)
        fit.known = KnownRotation.measured(measurement, window.duration) if measurement else None
        warm, coarse = last is not None, fit.contrasts[0.25]
        stop: str | None
        try:
            if last is not None:
                flows = last.flows(window)
                if fit.known is not None:
                    flows += [fit.rotated(flow, last.rotation(window)) for flow in flows]
                fit.flow = best_start(coarse, events, flows)
                last.predict(fit, window)
                self._model = last.model
                stop = self._fit_warm(events)
                # After the deadline there is no time for a cold fit, even if the flow is lost.
                warm = self._late() or not is_lost(
                    coarse, events, fit.flow, fresh_start(coarse, events, self.lattice.shape)
                )
            if not warm:
                self.reset()
                stop = self._fit_cold(events)
            gain = self._gain(events)
            if stop is None or self._shows_no_motion(events, gain):
                return self._nothing(window, len(events), Status.NO_MOTION, gain)
            change_px = self._change.measure(events, fit.flow)
            part = window.latest(self._change.steady(change_px, fit.flow, len(window.events)))
            if part is not window and warm and not whole and window.gyro is None:
                return self._estimate(part, None, whole=True)
            quality = Quality(
                len(events), self._iterations, stop, gain, warm=warm, change_px=change_px
            )
            result = self._result(window, quality)
        except np.linalg.LinAlgError:
            return self._nothing(window, len(events), Status.DIVERGED)
        if not (np.isfinite(result.angular).all() and np.isfinite(result.covariance).all()):
            return self._nothing(window, len(events), Status.DIVERGED)
        return result

    def _fit_cold(self, events: WindowEvents) -> str | None:
        """Search a constant flow, refine it, then add the egomotion; None if nothing moves."""
        fit = self._fit
        constant = cold_start(fit.contrasts[0.25], events, self.lattice.shape)
        fit.flow = constant
        if fit.known is not None:
            rotated = fit.rotated(np.zeros(self.lattice.shape, np.float32), np.zeros(3))
            fit.flow = best_start(fit.contrasts[0.25], events, [constant, rotated])
        fit.motion = fit.structure = None
        for scale, steps in ((0.25, 5), (0.5, 4), (1.0, 3)):
            for _ in range(steps):
                fit.linearise(events, scale)
                fit.step_free()
                self._iterations += 1
        fit.linearise(events, 1.0)
        if self._shows_no_motion(events, self._gain(events)):  # leave out the costly steps
            return None
        self._reconsider(fit.free_flow())
        return self._refine(events, self.config.cold_iterations, hurry=False)

    def _fit_warm(self, events: WindowEvents) -> str:
        """Correct a prediction of flow and motion from coarse to fine."""
        fit = self._fit
        few = events.every(max(1, len(events) // LATTICE.coarse_events))
        for scale, steps in ((0.25, 2), (0.5, 1)) if fit.known is None else ((0.5, 1),):
            for _ in range(steps):
                if self._late():
                    break
                fit.linearise(few, scale)
                self._step()
        return self._refine(events, self.config.warm_iterations, hurry=True)

    def _refine(self, events: WindowEvents, steps: int, *, hurry: bool) -> str:
        """Step at full resolution; before the last step look for another motion."""
        fit, stop = self._fit, "iterations"
        for k in range(steps):
            last = k == steps - 1
            if not last and hurry and self._late():
                stop, last = "deadline", True
            fit.linearise(events, 1.0)
            if last and self._reconsider(fit.free_flow()):
                fit.structure = None
                for _ in range(self.config.warm_iterations):
                    fit.linearise(events, 1.0)
                    self._step()
                    if hurry and self._late():
                        stop = "deadline"
                        break
                break
            self._step()
            if last:
                break
        return stop

    def _step(self) -> None:
        if self._model is MotionModel.ROTATION:
            self._fit.step_rotation()
        else:
            self._fit.step_coupled()
        self._iterations += 1

    def _late(self) -> bool:
        deadline = self.config.deadline_ms
        return deadline > 0 and (time.perf_counter() - self._started) * 1e3 > deadline

    def _reconsider(self, free: FreeFlow) -> bool:
        """Weigh the motions that explain a flow; return whether the fit must go on with another."""
        fit, epipolar, before = self._fit, self._epipolar, self._model
        sized = free.known is None
        others = epipolar.search(*free.evidence, sized=sized)
        rotation = epipolar.rotation(*free.evidence, sized=sized)
        best = others.at(int(others.cost.argmin()))
        here, middle, present = best, best.w[0], best.v[0]
        is_first, guessed = fit.motion is None, before is MotionModel.ROTATION  # v, that is
        if fit.motion is not None:
            middle, present = fit.motion.at(0.5)
            here = epipolar.score(present, *free.evidence, sized=sized)
        softness = temperature(here, others, epipolar.usable, free.seen[1]) if sized else 1.0
        margin = 0.0 if guessed else LATTICE.switch * here.residual[0]
        switch = bool(best.cost[0] < here.cost[0] - margin)
        if switch:
            here, present = best, best.v[0] if best.v[0] @ present >= 0 else -best.v[0]
        if switch or guessed:
            middle = here.w[0]
        self._free = free
        self._possible = PossibleMotions.weigh((middle, present), here, others, rotation, softness)
        self._face(free, here.w[0], present)
        if self.config.model == "auto":
            rotating = rotates(epipolar, free, rotation, here)
            self._model = MotionModel.ROTATION if rotating else MotionModel.FULL
        goes_on = is_first or self._model is not before or (switch and not guessed)
        if goes_on:
            fit.motion = Motion.constant(middle, present)
            if self._model is MotionModel.ROTATION:
                fit.start_rotation(rotation.w[0])
        return goes_on

    def _face(self, free: FreeFlow, w: Array, v: Array) -> None:
        """Tell on which side of the camera the scene lies, and let the fit rely on it if it may."""
        epipolar = self._epipolar
        evidence = epipolar.usable * np.trace(free.information, axis1=1, axis2=2)
        flow = np.einsum("nij,nj->ni", epipolar.to_bearing, free.flow)
        self._agreement = cheirality(epipolar.bearings, flow, v, w, evidence)
        sure = abs(self._agreement) > LATTICE.on_one_side
        self._fit.front = float(np.sign(self._agreement)) if sure else 0.0

    def _gain(self, events: WindowEvents) -> float:
        return contrast_gain(self._fit.contrasts[1.0], events, self._fit.flow)

    def _shows_no_motion(self, events: WindowEvents, gain: float) -> bool:
        """Tell whether the fit does not sharpen the events, or one spot is all that moves."""
        fit, config = self._fit, self.config
        if gain < config.min_contrast_gain:
            return True
        evidence = np.trace(fit.evidence, axis1=1, axis2=2)  # at each node, px^-2
        return config.model == "auto" and is_confined(
            self.lattice, fit.contrasts[1.0], events, fit.flow, evidence
        )

    def _result(self, window: Window, quality: Quality) -> Estimate:
        """Remember the window that was fitted, and report it."""
        fit = self._fit
        self._last = Memory.of(window, fit, self._model)
        if window.gyro is not None:
            w, covariance = self._reader.rotation_of_events(self._free)
            self._gyro.learn(w / window.duration, covariance / window.duration**2)
        return self._reader.read(
            window, self._free, self._model, self._possible, self._agreement, quality,
            self._gyro.status,
        )  # fmt: skip

    def _nothing(
        self, window: Window, used: int, status: Status, gain: float = float("nan")
    ) -> Estimate:
        """Report a window without a confident estimate; the next one starts cold."""
        self.reset()
        if status is not Status.DIVERGED:
            self._gyro.learn_at_rest()
        quality = Quality(used, self._iterations, str(status), gain)
        start, end = window.t_start, window.t_end
        return Estimate(start, end, (start + end) // 2, status, quality, gyro=self._gyro.status)
