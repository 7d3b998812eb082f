"""The published method as an estimator: one cold, seeded optimisation per window, and its flow.

The flow is that of the fitted field: at any instant, over any interval, along tracks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import SplineMotion
from emoflow_ros.core.types.estimate import Estimate, MotionModel, Quality, Status
from emoflow_ros.core.types.events import NS_PER_S, Events, Window
from emoflow_ros.errors import InputError
from emoflow_ros.published.assess import assess
from emoflow_ros.published.field import CoordinateMLP, warp
from emoflow_ros.published.fit import Problem, fit
from emoflow_ros.published.implicit_config import ImplicitConfig, WarpConfig
from emoflow_ros.published.losses import PixelMaps

# Points per evaluation: bounds the memory that the hidden layers take.
_BATCH = 16_384


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
            _require_cuda()
        self._camera = camera
        self._config = config
        self._maps = PixelMaps.of(camera, config.device)

    def reset(self) -> None:
        """Do nothing: every window starts cold."""

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to one window."""
        events = self._select(window.events)
        middle = (window.t_start + window.t_end) // 2
        if len(events) < self._config.min_events:
            return self._nothing(window, Status.TOO_FEW_EVENTS, Quality(len(events)))
        problem = self._problem(window, events)
        camera = self._camera
        result = fit(problem, self._config)
        quality = Quality(len(events), result.iterations, result.stop_reason)
        try:
            found = assess(problem, result, (camera.fx + camera.fy) / 2, self._config)
        except np.linalg.LinAlgError:  # the motion has no direction, or is not finite
            return self._nothing(window, Status.DIVERGED, quality)
        quality = replace(
            quality,
            contrast_gain=found.contrast_gain,
            residual_px=found.residual_px,
            inlier_fraction=found.inlier_fraction,
        )
        if found.status is not Status.OK:
            return self._nothing(window, found.status, quality)
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

    def _nothing(self, window: Window, status: Status, quality: Quality) -> Estimate:
        middle = (window.t_start + window.t_end) // 2
        quality = replace(quality, stop_reason=status.value)
        return Estimate(window.t_start, window.t_end, middle, status, quality)

    def _select(self, events: Events) -> Events:
        """Keep the events on the sensor, at most max_events of them, drawn at random."""
        events = events[events.inside(self._camera.width, self._camera.height)]
        if len(events) <= self._config.max_events:
            return events
        draw = np.random.default_rng(self._config.seed)
        share = None if events.stands_for is None else events.stands_for / events.came
        chosen = draw.choice(len(events), self._config.max_events, replace=False, p=share)
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


def _require_cuda() -> None:
    """Refuse a machine without a CUDA device, or with one that torch cannot use."""
    if not torch.cuda.is_available():
        raise InputError(
            "estimator.device", "no CUDA device was found", "use cpu, or check the driver"
        )


@dataclass(frozen=True)
class ImplicitFlow:
    """An `estimate.FlowSampler` over a coordinate network.

    Displacements are integrated by the solver and steps that the field was trained with.

    Attributes:
        field: the network; times count from t_start.
        t_start: the window's start, ns.
        width, height: sensor size in pixels.
        config: the ODE solver.
    """

    field: CoordinateMLP
    t_start: int
    width: int
    height: int
    config: WarpConfig

    def velocity(self, t: int) -> NDArray[np.float32]:
        """Flow at time t (ns), (height, width, 2) in px/s."""
        seconds = self._seconds(t)

        def flow(x: Tensor) -> Tensor:
            return self.field(seconds.expand(len(x)), x)

        return self._map(flow, self._pixels()).reshape(self.height, self.width, 2)

    def displacement(self, t0: int, t1: int) -> NDArray[np.float32]:
        """Where the pixels of t0 are at t1 (ns), minus where they were: (height, width, 2) px."""
        pixels = self._pixels()
        moved = self._integrate(pixels, t0, t1) - pixels
        return moved.reshape(self.height, self.width, 2)

    def tracks(self, points: NDArray[np.float64], times: Sequence[int]) -> NDArray[np.float64]:
        """Positions (len(times), N, 2) in px of points (N, 2) given at times[0] (ns)."""
        path = [points.astype(np.float32)]
        for t0, t1 in pairwise(times):
            path.append(self._integrate(path[-1], t0, t1))
        return np.stack(path).astype(np.float64)

    def _integrate(self, points: NDArray[np.float32], t0: int, t1: int) -> NDArray[np.float32]:
        start, end = self._seconds(t0), self._seconds(t1)

        def move(x: Tensor) -> Tensor:
            return warp(self.field, start.expand(len(x)), x, end, self.config)

        return self._map(move, points)

    @torch.no_grad()
    def _map(
        self, function: Callable[[Tensor], Tensor], points: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Apply a function of (N, 2) tensors to any number of points."""
        on_device = torch.from_numpy(points).to(self.field.centre.device)
        return torch.cat([function(x) for x in on_device.split(_BATCH)]).cpu().numpy()

    def _seconds(self, t: int) -> Tensor:
        seconds = (t - self.t_start) / NS_PER_S
        return torch.tensor(seconds, dtype=torch.float32, device=self.field.centre.device)

    def _pixels(self) -> NDArray[np.float32]:
        grid = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack(grid, axis=-1).reshape(-1, 2).astype(np.float32)
