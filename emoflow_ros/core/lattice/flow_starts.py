"""What a fit of the flow starts from, and when it is lost.

A contrast has many local maxima, and a flow near a wrong one still has a high contrast. Only a
comparison with the result of another start shows such an error: a fit starts from the best of
several flows, and it is dropped if a constant flow surpasses it.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.contrast import Contrast, best_constant_flow
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents

F32 = NDArray[np.float32]


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
    few = events.every(max(1, len(events) // LATTICE.search_events))
    return np.zeros(shape, np.float32) + best_constant_flow(contrast, few, LATTICE.search_reach_px)


def fresh_start(contrast: Contrast, events: WindowEvents, shape: tuple[int, ...]) -> F32:
    """Search the constant flow of this shape that sharpens the events best, knowing nothing.

    Args:
        contrast, events: as in `best_start`.
        shape: of the field, (columns, rows, times, 2).
    """
    return np.zeros(shape, np.float32) + best_constant_flow(
        contrast, _some(events), LATTICE.fresh_reach_px
    )


def is_lost(contrast: Contrast, events: WindowEvents, flow: F32, fresh: F32) -> bool:
    """Tell whether one constant flow, searched afresh, sharpens the events better than a fit does.

    Args:
        contrast, events: as in `best_start`.
        flow: (columns, rows, times, 2) the fit, px per window.
        fresh: what `fresh_start` has found.
    """
    few = _some(events)
    return contrast.sharpen(few, fresh) > LATTICE.lost * contrast.sharpen(few, flow)


def _some(events: WindowEvents) -> WindowEvents:
    return events.every(max(1, len(events) // LATTICE.low_resolution_events))
