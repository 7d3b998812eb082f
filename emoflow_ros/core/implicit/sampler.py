"""The fitted field's products: flow at any instant, displacement over any interval, tracks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from emoflow_ros.core.implicit.field import CoordinateMLP, warp
from emoflow_ros.core.implicit.implicit_config import WarpConfig
from emoflow_ros.core.windows import NS_PER_S

# Points per evaluation: bounds the memory that the hidden layers take.
_BATCH = 16_384


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
