"""A flow that changes linearly over its window, bent as the rotation is in between."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_field
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.types.estimate import Motion, angular_over
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]

_TIMES = 9  # at which the rotation over a window is read


class Bend:
    """Adds to a flow how the rotation in the window's middle differs from its mean.

    The lattice's flow changes linearly in time: of hands that tremble it is the mean. What is added
    in the middle is taken off at both ends, so that the way over the window stays.

    Args:
        camera: of the sensor, on which the flow lies.
    """

    def __init__(self, camera: Camera) -> None:
        self._camera = camera
        self._by_rotation: dict[tuple[int, int], Array] = {}

    def __call__(self, flow: LatticeFlow, motion: Motion) -> LatticeFlow:
        """Bend a flow of two times by a motion over its window; it has three times then."""
        length = flow.t_end - flow.t_start
        angular = angular_over(motion, flow.t_start, flow.t_end, _TIMES)
        mean = (angular[:-1] + angular[1:]).mean(axis=0) / 2
        bend = angular[_TIMES // 2] - mean
        rotation = self._rotational(flow.lattice) @ (bend * length / NS_PER_S)
        bump = rotation.reshape(*flow.values.shape[:2], 2)
        begin, end = flow.values[:, :, 0], flow.values[:, :, -1]
        values = np.stack([begin - bump, (begin + end) / 2 + bump, end - bump], axis=2)
        lattice = replace(flow.lattice, times=3)
        return replace(flow, lattice=lattice, values=values.astype(np.float32))

    def _rotational(self, lattice: Lattice) -> Array:
        """Flow (nodes, 2, 3) at a lattice's nodes by an angular velocity, px/rad."""
        shape = lattice.columns, lattice.rows
        if shape not in self._by_rotation:
            self._by_rotation[shape] = motion_field(self._camera, lattice.pixels)[1]
        return self._by_rotation[shape]
