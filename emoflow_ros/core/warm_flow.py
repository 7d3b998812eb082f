"""Where the flow of a warm window starts, and whether it has got lost.

A contrast has many local maxima. A window that starts near the wrong one keeps a high contrast, so
only the comparison with what another start reaches shows it.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.contrast import ImageContrast, WindowEvents, best_constant_flow

F32 = NDArray[np.float32]

_EVENTS = 2_000  # are enough at low resolution
_REACH_PX = 16.0  # of the fresh search, per window
_BETTER = 1.05  # contrast of a constant flow over that of the fit from which the fit is lost


def best_start(contrast: ImageContrast, events: WindowEvents, flows: list[F32]) -> F32:
    """Choose the flow (columns, rows, times, 2) that sharpens the events best.

    Args:
        contrast: at a low resolution, whose maxima are wide.
        events: of the window.
        flows: to choose from.
    """
    few = _some(events)
    return max(flows, key=lambda flow: contrast.gain(few, flow))


def fresh_start(contrast: ImageContrast, events: WindowEvents, shape: tuple[int, ...]) -> F32:
    """Search the constant flow of this shape that sharpens the events best, knowing nothing.

    Args:
        contrast, events: as in `best_start`.
        shape: of the field, (columns, rows, times, 2).
    """
    return np.zeros(shape, np.float32) + best_constant_flow(contrast, _some(events), _REACH_PX)


def is_lost(contrast: ImageContrast, events: WindowEvents, flow: F32, fresh: F32) -> bool:
    """Tell whether one constant flow, searched afresh, sharpens the events better than a fit does.

    Args:
        contrast, events: as in `best_start`.
        flow: (columns, rows, times, 2) the fit, px per window.
        fresh: what `fresh_start` has found.
    """
    few = _some(events)
    return contrast.gain(few, fresh) > _BETTER * contrast.gain(few, flow)


def _some(events: WindowEvents) -> WindowEvents:
    return events.every(max(1, len(events) // _EVENTS))
