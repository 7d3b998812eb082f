"""The published method as an estimator: one cold, seeded optimisation per window."""

import time

import numpy as np
import torch

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.camera_motion import SplineMotion
from emoflow_ros.core.device import require_cuda
from emoflow_ros.core.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.events import Events
from emoflow_ros.core.implicit.assess import assess
from emoflow_ros.core.implicit.fit import Problem, fit
from emoflow_ros.core.implicit.implicit_config import ImplicitConfig
from emoflow_ros.core.implicit.losses import PixelMaps
from emoflow_ros.core.implicit.sampler import ImplicitFlow
from emoflow_ros.core.windows import NS_PER_S, Window


class ImplicitEstimator:
    """An `estimate.Estimator` that fits a coordinate network and spline motion to each window.

    On the CPU the same window, configuration and number of threads give the same estimate
    bit by bit, whatever was estimated before.

    Args:
        camera: the calibrated camera.
        config: see `ImplicitConfig`.

    Raises:
        InputError: the configured device is not there.
    """

    def __init__(self, camera: Camera, config: ImplicitConfig) -> None:
        if config.device == "cuda":
            require_cuda()
        self._camera = camera
        self._config = config
        self._maps = PixelMaps.of(camera, config.device)

    def reset(self) -> None:
        """Do nothing: every window starts cold."""

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to one window."""
        began = time.perf_counter()
        events = self._select(window.events)
        middle = (window.t_start + window.t_end) // 2
        if len(events) < self._config.min_events:
            status = Status.TOO_FEW_EVENTS
            quality = Quality(len(events), stop_reason=status.value)
            return Estimate(window.t_start, window.t_end, middle, status, quality)
        problem = self._problem(window, events)
        camera = self._camera
        result = fit(problem, self._config)
        found = assess(problem, result, (camera.fx + camera.fy) / 2, self._config)
        ok = found.status is Status.OK
        quality = Quality(
            events=len(events),
            iterations=result.iterations,
            stop_reason=result.stop_reason if ok else found.status.value,
            contrast_gain=found.contrast_gain,
            residual_px=found.residual_px,
            inlier_fraction=found.inlier_fraction,
            runtime_s=time.perf_counter() - began,
        )
        if not ok:
            return Estimate(window.t_start, window.t_end, middle, found.status, quality)
        rotation = self._config.loss.geometry == "rotation"
        motion = SplineMotion(
            window.t_start, window.t_end, found.angular_points, found.linear_points
        )
        return Estimate(
            window.t_start,
            window.t_end,
            middle,
            Status.OK,
            quality,
            model=MotionModel.ROTATION if rotation else MotionModel.FULL,
            linear=motion.linear(middle),
            angular=motion.angular(middle),
            covariance=found.covariance,
            flow=ImplicitFlow(
                result.field, window.t_start, camera.width, camera.height, self._config.warp
            ),
            motion=motion,
        )

    def _select(self, events: Events) -> Events:
        """Keep the events on the sensor, at most max_events of them, drawn at random."""
        events = events[events.inside(self._camera.width, self._camera.height)]
        if len(events) <= self._config.max_events:
            return events
        draw = np.random.default_rng(self._config.seed)
        chosen = draw.choice(len(events), self._config.max_events, replace=False)
        return events[np.sort(chosen)]

    def _problem(self, window: Window, events: Events) -> Problem:
        seconds = (events.t - window.t_start) / NS_PER_S
        pixels = np.stack([events.x, events.y], axis=-1)
        return Problem(
            t=torch.tensor(seconds, dtype=torch.float32, device=self._config.device),
            x=torch.tensor(pixels, dtype=torch.float32, device=self._config.device),
            duration=window.duration,
            maps=self._maps,
        )
