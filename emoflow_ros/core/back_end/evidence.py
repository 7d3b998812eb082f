"""What the adjustment takes: places of patches as observations, measured velocities as a prior."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.back_end.adjustment_kernels import Observations
from emoflow_ros.core.back_end.prior_kernels import Prior
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.walks import Walks
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True)
class Measured:
    """A motion that one window's flow shows by itself.

    Attributes:
        t: ns.
        angular: (3,) rad/s.
        root: (3, 3) square root of the information on it.
        direction: (3,) of translation, zeros where unknown: a start, no evidence.
    """

    t: int
    angular: Array
    root: Array
    direction: Array


def observations(patches: Patches, settings: BackEndSettings) -> Observations:
    """List where patches were seen, other than in the first slice that shows them.

    Args:
        patches: each seen in two slices at least.
        settings: of the back end.
    """
    count = len(patches)
    every, first = np.arange(count), patches.first
    later = patches.found.copy()
    later[every, first] = False
    patch, node = (np.ascontiguousarray(index) for index in np.nonzero(later))
    return Observations(
        patch, node, patches.seen[patch, node], patches.root[patch, node],
        first, patches.seen[every, first],
        np.ones(count), np.full(count, settings.depth_sd),
    )  # fmt: skip


def prior(
    t: Times, measured: tuple[Measured, ...], walks: Walks, settings: BackEndSettings
) -> Prior:
    """Collect what is known of the motion at nodes (K,) ns besides the places of patches."""
    within = [m for m in measured if t[0] <= m.t <= t[-1]]
    times = np.array([m.t for m in within], np.int64)
    node = np.clip(np.searchsorted(t, times, "right") - 1, 0, len(t) - 2)
    return Prior(
        np.diff(t) / NS_PER_S,
        walks.angular,
        walks.velocity,
        settings.speed_sd,
        node,
        (times - t[node]) / (t[node + 1] - t[node]),
        np.array([m.angular for m in within]).reshape(-1, 3),
        np.array([m.root for m in within]).reshape(-1, 3, 3),
        settings.lattice_outlier,
    )
