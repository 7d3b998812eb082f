"""Windows by motion: of each window only the latest part, as long as the motion allows."""

import numpy as np

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.estimate import Estimate, Estimator, FlowSampler, Status
from emoflow_ros.core.windows import Window, WindowPolicy

_GRID_PX = 16  # between the pixels whose displacement counts
_STILL_PX = 1e-3
_FAST = 0.9  # quantile of the displacements that counts: where it is fast, warps fail first
_FIRST = 2 / 3  # of the window's events in the first part, before any motion is known


class MotionWindows:
    """Estimates the latest part of each window that the motion allows (an Estimator).

    Events are what edges leave behind per pixel that they move: a part with the events of
    `max_displacement_px` pixels, as many as the last part's events and displacement tell, is short
    as soon as the camera is fast, and long when events are few. Its length depends on nothing but
    the windows so far. A part never begins before the one before it, so that the estimates' times
    grow.

    The first part holds two thirds of its window's events. Where a part gives no estimate the next
    one has twice its events, until it is a whole window; then it is min_count events.

    Args:
        estimator: of the parts.
        camera: whose pixels are displaced.
        policy: max_displacement_px and min_count.
    """

    def __init__(self, estimator: Estimator, camera: Camera, policy: WindowPolicy) -> None:
        self._estimator = estimator
        self._policy = policy
        columns = np.arange(_GRID_PX // 2, camera.width, _GRID_PX)
        rows = np.arange(_GRID_PX // 2, camera.height, _GRID_PX)
        self._grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2).astype(float)
        self._forget()

    def reset(self) -> None:
        """Forget previous windows: the next one starts cold."""
        self._forget()
        self._estimator.reset()

    def _forget(self) -> None:
        self._count: int | None = None
        self._start: int | None = None

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to the latest part of a window."""
        part = window.since(self._choose_start(window))
        estimate = self._estimator.estimate(part)
        self._start = part.t_start
        self._count = self._next_count(estimate, part, window)
        return estimate

    def _choose_start(self, window: Window) -> int:
        """Go back by the number of events, to the window's start or the last part's at most."""
        count = round(_FIRST * len(window.events)) if self._count is None else self._count
        first = len(window.events) - max(self._policy.min_count, count)
        start = int(window.events.t[first]) if first > 0 else window.t_start
        if self._start is not None:
            start = max(start, self._start)
        return min(start, window.t_end - 1)

    def _next_count(self, estimate: Estimate, part: Window, window: Window) -> int:
        if estimate.status is Status.OK and estimate.flow is not None:
            moved = max(_STILL_PX, self._displacement(estimate.flow, part))
            return round(len(part.events) * self._policy.max_displacement_px / moved)
        return 0 if part is window else 2 * len(part.events)

    def _displacement(self, flow: FlowSampler, part: Window) -> float:
        """Way that 90 % of the image's pixels keep to from the part's start to its end, px."""
        end = flow.tracks(self._grid, (part.t_start, part.t_end))[1]
        return float(np.quantile(np.linalg.norm(end - self._grid, axis=1), _FAST))
