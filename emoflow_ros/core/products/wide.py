"""Why the covariance of an estimate is large, in one word."""

import numpy as np

from emoflow_ros.core.products.settings import STREAM
from emoflow_ros.core.types.estimate import Estimate, Status


def why_wide(estimate: Estimate) -> str:
    """Say why w or v is wide; empty where both are narrow.

    Returns:
        What kept a motion from being measured (a Status or `brightness`), or of a measured one
        `start`: no window before it helps; `events`: they are few; `motion`: it sharpens the
        events little; else `ambiguous`: a rotation and a translation explain the flow alike.
    """
    if estimate.status in (Status.CARRIED, Status.BOUNDED, Status.LOST):
        return estimate.quality.stop_reason
    if not estimate.told or not _is_wide(estimate):
        return ""
    quality = estimate.quality
    if not quality.warm:
        return "start"
    if quality.events < STREAM.few_events:
        return "events"
    return "motion" if quality.contrast_gain < STREAM.low_gain else "ambiguous"


def _is_wide(estimate: Estimate) -> bool:
    covariance = estimate.covariance
    if np.linalg.eigvalsh(covariance[3:, 3:])[-1] > STREAM.narrow_w**2:
        return True
    translates = estimate.translation_observable
    return translates and bool(np.linalg.eigvalsh(covariance[:3, :3])[-1] > STREAM.narrow_v**2)
