"""Windows by motion: of each window only the latest part, as long as the motion allows.

A part also has to be short enough for the fit to follow the changes of the motion within it, which
`MotionChange` measures.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.preparation import reduction
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.stream.thinning import first_of_latest
from emoflow_ros.core.types.estimate import Estimate, Estimator, FlowSampler, Status
from emoflow_ros.core.types.events import Window, WindowPolicy

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

_GRID_PX = 16  # distance between the pixels whose displacement counts
_STILL_PX = 1e-3
_LEGS = 4  # straight pieces that a path is measured in: a shaking camera turns back on its way

_THIRD = 1 / 3  # share of a window


class MotionWindows:
    """Estimates the latest part of each window that the motion allows (an Estimator).

    An edge makes events for each pixel that it moves. So the number of events, counted as they
    came, measures the displacement. The last part's events and displacement tell how many events
    `max_displacement_px` pixels make, and the next part has so many. Such a part is short if the
    camera is fast, and long if events are few. Its length depends only on the windows so far. A
    part never begins before the last one with a flow, nor so early that its middle is not after
    that of the last estimate. So the estimates' times increase.

    A displacement is the length of the path: a camera that shakes leaves events on its way back,
    too. A motion that changes within a part by more than the fit can follow (`change_px` of its
    quality) shortens the next one in the same way.

    While no motion was seen, a part is as long as the expected flow allows. Where none is expected,
    whole windows are tried, for long parts of slow motion tell much more than short ones; if
    failures go on, a quarter or 6 % of the events in every second window.

    Args:
        estimator: of the parts.
        camera: whose pixels are displaced.
        policy: max_displacement_px, in pixels of the working image, and min_count.
    """

    def __init__(self, estimator: Estimator, camera: Camera, policy: WindowPolicy) -> None:
        self._estimator = estimator
        self._policy = policy
        self._longest_px = policy.max_displacement_px * reduction(camera)
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
        self._failures = 0
        self._start: int | None = None
        self._t: int | None = None  # time of the last estimate without a flow, ns

    def estimate(self, window: Window) -> Estimate:
        """Fit flow and egomotion to the latest part of a window."""
        if self._count is None:
            part = self._first_part(window)
        else:
            part = window.since(self._choose_start(window, self._count))
        estimate = self._estimator.estimate(part)
        if estimate.flow is None:
            if estimate.status is Status.OK:
                self._t = estimate.t
            self._count = None
            self._failures += 1
            return estimate
        part = part.since(estimate.t_start)
        self._failures = 0
        self._start = part.t_start
        self._count = self._next_count(estimate.flow, estimate.quality.change_px, part)
        return estimate

    def _first_part(self, window: Window) -> Window:
        """Choose a part while no motion was seen: as long as what is expected allows, or try."""
        if window.expected is not None:
            way = window.duration * np.linalg.norm(window.expected.flow(self._grid), axis=1)
            share = self._longer(way)
        else:
            tried = max(0, self._failures - 1) % len(LATTICE.first_shares)
            share = LATTICE.first_shares[tried]
        return window.since(self._choose_start(window, round(share * window.events.came)))

    def _choose_start(self, window: Window, count: int) -> int:
        """Go back by the number of events, to the window's or the last estimate's start at most."""
        events = window.events
        first = min(len(events) - self._policy.min_count, first_of_latest(events, count))
        start = int(events.t[first]) if first > 0 else window.t_start
        if self._start is not None:
            start = max(start, self._start)
        if self._t is not None:
            start = max(start, 2 * self._t + 2 - window.t_end)
        return min(start, window.t_end - 1)

    def _next_count(self, flow: FlowSampler, change_px: float, part: Window) -> int:
        longer = self._longer(self._way(flow, part))
        if change_px > 0:  # it grows with the square of the time
            longer = min(longer, (LATTICE.change_px / change_px) ** 0.5)
        return round(part.events.came * longer)

    def _longer(self, way: Array) -> float:
        """How many times as long a part may be whose pixels move by (N,) px: 90 % keep to that."""
        return self._longest_px / max(_STILL_PX, float(np.quantile(way, LATTICE.fast)))

    def _way(self, flow: FlowSampler, part: Window) -> Array:
        """Length of the paths of the grid's pixels in the part, (N,) px."""
        length = part.t_end - part.t_start
        times = [part.t_start + leg * length // _LEGS for leg in range(_LEGS + 1)]
        legs = np.diff(flow.tracks(self._grid, times), axis=0)
        return np.asarray(np.linalg.norm(legs, axis=-1).sum(axis=0))


class MotionChange:
    """Measures how far the ends of a window move off its fitted flow.

    Args:
        contrast: at a low resolution, whose maxima are wide.
    """

    def __init__(self, contrast: Contrast) -> None:
        self._contrast = contrast

    def measure(self, events: WindowEvents, flow: F32) -> float:
        """Return how far the first or the last third of the window moves off the flow, px.

        One Newton step on the contrast of the third's events alone, for a velocity that the whole
        image shares; the larger of the two displacements within a third. One step goes too far, by
        a fifth where dots move by 1 to 3 px.

        Args:
            events: of the window.
            flow: (columns, rows, times, 2) px per window.
        """
        return max(self._shift(events, flow, begin) for begin in (0.0, 1 - _THIRD))

    def steady(self, change_px: float, flow: F32, count: int) -> int:
        """How many of a window's events, the latest ones, show a motion that a fit can follow.

        The change grows with the square of the time. A short way, or few events, tell less of the
        motion than a fit that does not follow all of it.

        Args:
            change_px: of the window.
            flow: (columns, rows, times, 2) px per window.
            count: of the window's events.
        """
        if change_px <= LATTICE.unsteady_px:
            return count
        way = float(np.median(np.linalg.norm(flow.mean(axis=2), axis=-1)))
        share = (LATTICE.steady_px / change_px) ** 0.5
        share = max(share, LATTICE.shortest_way_px / max(_STILL_PX, way))
        return min(count, max(round(share * count), LATTICE.third_events))

    def _shift(self, events: WindowEvents, flow: F32, begin: float) -> float:
        part = events.between(begin, begin + _THIRD)
        if len(part) < LATTICE.few_events:
            return 0.0
        few = part.every(max(1, len(part) // LATTICE.third_events))
        force, stiffness = self._contrast.linearise(few, flow, begin + _THIRD / 2).of_common_shift()
        regular = stiffness + 1e-6 * (1 + np.trace(stiffness)) * np.eye(2)
        return float(np.linalg.norm(np.linalg.solve(regular, force))) * _THIRD
