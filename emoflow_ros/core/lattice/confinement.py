"""Whether all that moves is one spot: perhaps an object before a camera at rest.

Such an object is taken for a rotation of the camera otherwise. Where the camera moves, the events
elsewhere become sharper, too, however few they are. Where it is at rest, they are noise.
"""

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.lattice.contrast import Contrast, contrast_gain
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents

Array = NDArray[np.float64]

_FEWEST_NODES = 5  # along each side; on a coarser lattice everything is one spot


def is_confined(
    lattice: Lattice, contrast: Contrast, events: WindowEvents, flow: NDArray[np.float32],
    evidence: Array,
) -> bool:  # fmt: skip
    """Tell whether only one spot of the image moves along the flow.

    Args:
        lattice: of the flow.
        contrast: at full resolution.
        events: of the window.
        flow: (columns, rows, times, 2) px per window.
        evidence: (nodes,) how much the events say about the flow at each node.
    """
    middle, covariance = spot(lattice, evidence)
    if not spread(lattice, covariance) < LATTICE.one_spot:  # nor where it is not finite
        return False
    inverse = np.linalg.inv(covariance + LATTICE.least_sigma_px**2 * np.eye(2))
    away = np.stack([events.x, events.y], axis=-1) - middle
    elsewhere = np.einsum("ni,ij,nj->n", away, inverse, away) > LATTICE.elsewhere**2
    if np.count_nonzero(elsewhere) < LATTICE.fewest_elsewhere:
        return True
    return contrast_gain(contrast, events.at(elsewhere), flow) < LATTICE.sharper


def spot(lattice: Lattice, evidence: Array) -> tuple[Array, Array]:
    """Return mean (2,) and covariance (2, 2) of the evidence's place, px.

    The lesser half of its density is taken for noise: the median is subtracted first. Where nothing
    is left, and on lattices that are too coarse, they are those of an even density.
    """
    share = np.ones((lattice.columns, lattice.rows))  # of a cell, that a node stands for
    share[[0, -1]] /= 2
    share[:, [0, -1]] /= 2
    density = evidence / share.ravel()
    weights = share.ravel() * np.maximum(0.0, density - np.median(density))
    size = np.array([lattice.width, lattice.height], np.float64)
    if min(lattice.columns, lattice.rows) < _FEWEST_NODES or not weights.any():
        return size / 2, np.diag(size**2) / 12
    weights = weights / weights.sum()
    middle: Array = weights @ lattice.pixels
    away = lattice.pixels - middle
    return middle, (weights * away.T) @ away


def spread(lattice: Lattice, covariance: Array) -> float:
    """Return the share of the image for one compact spot, about 1 for edges all over the image.

    It is the root of the determinant of the covariance, over that of an even density.
    """
    determinant = max(0.0, float(np.linalg.det(covariance)))
    return 12 * float(np.sqrt(determinant)) / (lattice.width * lattice.height)
