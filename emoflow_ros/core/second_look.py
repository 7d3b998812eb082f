"""How a flow is started and checked against a fresh search.

A contrast has many local maxima, and a flow near a wrong one still has a high contrast. Only a
comparison with the result of another start shows such an error. The lattice estimator compares at
three places: it starts from the best of several flows, it drops a fit that a constant flow
surpasses, and it measures the distance to a second fit that does not know the estimate, which is
a part of its covariance (core.uncertainty). The same fit, at a quick look, tells how long a first
part of a window may be (core.motion_windows).
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import ThreadpoolController

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.contrast import (
    Contrast,
    best_constant_flow,
    contrast_gain,
)
from emoflow_ros.core.events import Window
from emoflow_ros.core.lattice import Lattice, LatticeFlow
from emoflow_ros.core.lattice_config import LatticeConfig
from emoflow_ros.core.lattice_kernels import length_at
from emoflow_ros.core.normal_equations import NormalEquations
from emoflow_ros.core.preparation import WorkingImage, prepare
from emoflow_ros.core.window_events import WindowEvents

F32 = NDArray[np.float32]

_ALL = 1_000_000_000
# Scale of the image, number of events, times of the flow in the window, steps. With a part of the
# events, or a flow that does not change, in the last steps the distance from the estimate says less
# about its error; full resolution adds nothing.
_STEPS = ((0.25, 2_000, 1, 5), (0.5, _ALL, 2, 2))
SCALES = tuple(scale for scale, _, _, _ in _STEPS)

# The search for a start of a cold fit: number of events, and reach in px per window.
_SEARCH_EVENTS = 6_000
_SEARCH_REACH_PX = 48.0

_EVENTS = 2_000  # number of events that is enough at low resolution
_REACH_PX = 16.0  # reach of the fresh search, px per window
_SHARE = 0.75  # share of the events that count: a few at depth edges may lie far apart
_BETTER = 1.05  # contrast of a constant flow over that of the fit: from here on the fit is lost


class SecondLook:
    """Fits flows by the events alone, without the epipolar constraint, from coarse to fine.

    The epipolar constraint can hold a flow at a maximum of the contrast that the events do not
    support. This fit then comes out elsewhere. Where the events leave no doubt it comes out close
    to the estimate.

    Args:
        lattice: of the flow.
        contrasts: by scale, those of SCALES.
        config: for the smoothness.
    """

    def __init__(
        self, lattice: Lattice, contrasts: Mapping[float, Contrast], config: LatticeConfig
    ) -> None:
        self._equations = [
            NormalEquations(replace(lattice, times=times), 0) for _, _, times, _ in _STEPS
        ]
        self._contrasts = contrasts
        self._config = config

    def flow(self, events: WindowEvents, start: F32) -> F32:
        """Fit the flow (columns, rows, times, 2), px per window.

        Args:
            events: of the window.
            start: a constant flow.

        Raises:
            NotPositiveDefiniteError: the events have no best flow.
        """
        flow = start
        for (scale, number, times, steps), equations in zip(_STEPS, self._equations, strict=True):
            few = events.every(max(1, len(events) // number))
            for _ in range(steps):
                cells = self._contrasts[scale].linearise(few, flow)
                equations.set_up(cells, flow[:, :, :times], self._config)
                flow = (flow + equations.solve().reshape(equations.lattice.shape)).astype(
                    np.float32
                )
        return flow


class QuickLook:
    """Finds the flow of a window quickly: by the events alone, at low resolution.

    Args:
        camera: with its lens.
        config: of the estimator.
    """

    def __init__(self, camera: Camera, config: LatticeConfig) -> None:
        self._image = WorkingImage.of(camera)
        self._lattice = Lattice.with_spacing(*self._image.camera.size, config.spacing_px)
        self._contrasts = {scale: Contrast(self._lattice, scale) for scale in SCALES}
        self._fit = SecondLook(self._lattice, self._contrasts, config)
        self._config = config
        self._threads = ThreadpoolController()

    def flow(self, window: Window) -> LatticeFlow | None:
        """Return the flow on the sensor; None if it does not sharpen the events."""
        events = prepare(window, self._image, self._config)
        if events is None:
            return None
        start = cold_start(self._contrasts[min(SCALES)], events, self._lattice.shape)
        try:
            with self._threads.limit(limits=1, user_api="blas"):
                flow = self._fit.flow(events, start)
        except np.linalg.LinAlgError:
            return None
        if (
            contrast_gain(self._contrasts[max(SCALES)], events, flow)
            < self._config.min_contrast_gain
        ):
            return None
        lattice, field = self._image.on_sensor(self._lattice, flow)
        return LatticeFlow(lattice, field, window.t_start, window.t_end)


def distance(lattice: Lattice, one: F32, other: F32, events: WindowEvents) -> float:
    """Return the distance that two flows keep to at three quarters of the events, px per window.

    Args:
        lattice: of the flows.
        one, other: (columns, rows, times, 2), px per window; their means over time count.
        events: of the window.
    """
    few = _some(events)
    return float(length_at((one - other).mean(axis=2), few.x, few.y, lattice.per_px, _SHARE))


def best_start(contrast: Contrast, events: WindowEvents, flows: list[F32]) -> F32:
    """Choose the flow (columns, rows, times, 2) that sharpens the events best.

    Args:
        contrast: at a low resolution, whose maxima are wide.
        events: of the window.
        flows: to choose from.
    """
    few = _some(events)
    return max(flows, key=lambda flow: contrast.sharpen(few, flow))


def cold_start(contrast: Contrast, events: WindowEvents, shape: tuple[int, ...]) -> F32:
    """Search the constant flow like `fresh_start`, but further and with more events."""
    few = events.every(max(1, len(events) // _SEARCH_EVENTS))
    return np.zeros(shape, np.float32) + best_constant_flow(contrast, few, _SEARCH_REACH_PX)


def fresh_start(contrast: Contrast, events: WindowEvents, shape: tuple[int, ...]) -> F32:
    """Search the constant flow of this shape that sharpens the events best, knowing nothing.

    Args:
        contrast, events: as in `best_start`.
        shape: of the field, (columns, rows, times, 2).
    """
    return np.zeros(shape, np.float32) + best_constant_flow(contrast, _some(events), _REACH_PX)


def is_lost(contrast: Contrast, events: WindowEvents, flow: F32, fresh: F32) -> bool:
    """Tell whether one constant flow, searched afresh, sharpens the events better than a fit does.

    Args:
        contrast, events: as in `best_start`.
        flow: (columns, rows, times, 2) the fit, px per window.
        fresh: what `fresh_start` has found.
    """
    few = _some(events)
    return contrast.sharpen(few, fresh) > _BETTER * contrast.sharpen(few, flow)


def _some(events: WindowEvents) -> WindowEvents:
    return events.every(max(1, len(events) // _EVENTS))
