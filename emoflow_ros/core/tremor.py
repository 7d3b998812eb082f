"""Tremor: what the angular velocity in a window's middle has beyond that of the fitted flow.

Hands tremble at 6 to 15 Hz. The flow of a window changes linearly in time, so its motion is a mean
over the window, and a tremor drops out of it. The events of the window's middle tell the rest: a
rotation that all pixels share is three numbers, for which they are enough.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.camera_motion import SplineMotion
from emoflow_ros.core.contrast import Contrast
from emoflow_ros.core.earlier_scene import KnownScene
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.estimate import Estimate
from emoflow_ros.core.events import NS_PER_S
from emoflow_ros.core.lattice import LatticeFlow
from emoflow_ros.core.preparation import WorkingImage
from emoflow_ros.core.window_events import WindowEvents

Array = NDArray[np.float64]

_BEGIN, _END = 0.2, 0.8  # part of the window that is its middle
_EVENTS = 8_000  # are enough for three numbers
_FEWEST_EVENTS = 300
# Scale and steps. Steps at 1/2 alone do not converge: the first one is too long.
_STEPS = ((0.25, 1), (0.5, 1))
_EXPECTED = np.radians(8.0)  # rad/s, standard deviation of a tremor in each axis
# Control points of the cubic B-spline 1 - 12 (s - 1/2)^2: 1 in the middle, 0 in the mean.
_BUMP = np.array([-22.0, 2.0, 2.0, -22.0])


class Tremor:
    """Adds the tremor in a window's middle to its estimate.

    Args:
        image: that the lattice lies on.
        epipolar: the rotational flow at the lattice's nodes.
        contrasts: by scale, 1/4 and 1/2.
    """

    def __init__(
        self,
        image: WorkingImage,
        epipolar: NodeEpipolar,
        contrasts: Mapping[float, Contrast],
    ) -> None:
        self._image = image
        self._epipolar = epipolar
        self._contrasts = contrasts

    def add_to(
        self, estimate: Estimate, events: WindowEvents, flow: NDArray[np.float32]
    ) -> Estimate:
        """Add what the events of the middle tell to w, its covariance and the flow.

        The change c of w in the middle, with information L, counts by the share
        1 - 1 / (c^T L c), the less the weaker the evidence is (after James and Stein, 1961).
        L includes what is expected beforehand.

        Args:
            estimate: of the window, with a flow.
            events: of the window.
            flow: (columns, rows, times, 2) the fit, px per window.
        """
        seconds = (estimate.t_end - estimate.t_start) / NS_PER_S
        found = self._change(events, flow, _EXPECTED * seconds)
        if found is None:
            return estimate
        change, information = found
        strength = float(change @ information @ change)
        if not strength > 1:
            return estimate
        share = 1 - 1 / strength
        covariance = estimate.covariance.copy()
        covariance[3:, 3:] += share * np.linalg.inv(information) / seconds**2
        return self._bent(replace(estimate, covariance=covariance), share * change / seconds)

    def _change(
        self, events: WindowEvents, flow: NDArray[np.float32], expected: float
    ) -> tuple[Array, Array] | None:
        """Change of w (3,), rad per window, and the information (3, 3) on it; None without."""
        middle = events.between(_BEGIN, _END)
        if len(middle) < _FEWEST_EVENTS:
            return None
        few = middle.every(max(1, len(middle) // _EVENTS))
        nodes = flow.mean(axis=2).reshape(-1, 2).astype(np.float64)
        known = KnownScene.at_depths(self._epipolar, nodes, np.zeros(len(nodes)))
        none = np.zeros(3), np.eye(3) / expected**2
        try:
            return known.fit(self._contrasts, _STEPS, few, 1.0, none)
        except np.linalg.LinAlgError:
            return None

    def _bent(self, estimate: Estimate, w: Array) -> Estimate:
        """Add w (3,), rad/s, to motion and flow in the middle, and take it away towards both ends.

        So rotation and displacement over the window stay.
        """
        flow, motion = estimate.flow, estimate.motion
        assert isinstance(flow, LatticeFlow) and isinstance(motion, SplineMotion)
        begin, end = flow.values[:, :, 0], flow.values[:, :, -1]
        seconds = (estimate.t_end - estimate.t_start) / NS_PER_S
        turn = (self._epipolar.b @ w * seconds).reshape(begin.shape) * self._image.sensor_px
        values = np.stack([begin - turn, (begin + end) / 2 + turn, end - turn], axis=2)
        points = motion.angular_points + np.outer(_BUMP, w)
        lattice = replace(flow.lattice, times=3)
        return replace(
            estimate,
            angular=estimate.angular + w,
            flow=replace(flow, lattice=lattice, values=values.astype(np.float32)),
            motion=replace(motion, angular_points=points),
        )
