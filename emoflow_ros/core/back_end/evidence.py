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
from emoflow_ros.core.types.gyro import KnownBias

Array = NDArray[np.float64]
Times = NDArray[np.int64]

_LEAST = 1e-10  # variance of a bias, (rad/s)^2: one that is surely known


@dataclass(frozen=True)
class Measured:
    """A motion that one window's flow shows by itself.

    Attributes:
        t_start, t_end: the window, ns.
        angular: (3,) rad/s, mean over the window.
        root: (3, 3) square root of the information on it.
        direction: (3,) of translation, zeros where unknown: a start, no evidence.
        bias: what was known of the bias of the gyro that measured; None if none did.
    """

    t_start: int
    t_end: int
    angular: Array
    root: Array
    direction: Array
    bias: KnownBias | None = None

    @property
    def t(self) -> int:
        """Middle of the window, ns."""
        return (self.t_start + self.t_end) // 2


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
    newest = next((m.bias for m in reversed(within) if m.bias is not None), None)
    return Prior(
        np.diff(t) / NS_PER_S,
        walks.angular,
        walks.velocity,
        settings.speed_sd,
        np.array([_without_bias(m, newest) for m in within]).reshape(-1, 3),
        np.array([_shares(t, m) for m in within]).reshape(-1, len(t)),
        np.array([m.root for m in within]).reshape(-1, 3, 3),
        settings.lattice_outlier,
        np.array([m.bias is not None for m in within], np.bool_),
        np.eye(3) if newest is None else np.linalg.inv(newest.covariance + _LEAST * np.eye(3)),
    )


def _without_bias(window: Measured, newest: KnownBias | None) -> Array:
    """A window's angular velocity (3,) without the bias that is known by now."""
    if window.bias is None or newest is None:
        return window.angular
    return np.asarray(window.angular + window.bias.mean - newest.mean)


def _shares(t: Times, window: Measured) -> Array:
    """How much of a window lies between nodes (K,) ns, and after the newest, (K,); in all one.

    What lies before the oldest is taken for like the rest.
    """
    begin = np.maximum(t, window.t_start)
    end = np.minimum(np.append(t[1:], np.iinfo(np.int64).max), window.t_end)
    within = np.maximum(end - begin, 0).astype(np.float64)
    return within / within.sum()
