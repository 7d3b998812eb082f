"""Two flows of a window as one: where which of them is sharper tells which is nearer.

The lattice's flow is smooth between nodes that are far apart, and may be lost; known depths tell
nothing of what lies between them, or moves by itself. Their errors differ from place to place.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import motion_field
from emoflow_ros.core.lattice.between_depths import BetweenDepths, nearness
from emoflow_ros.core.lattice.contrast import Contrast
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.kernels import MARGIN
from emoflow_ros.core.lattice.known import Structure
from emoflow_ros.core.lattice.refinement import Depths, rotation_at_ends
from emoflow_ros.core.lattice.settings import LATTICE
from emoflow_ros.core.lattice.window_events import WindowEvents
from emoflow_ros.core.types.estimate import Estimate
from emoflow_ros.core.types.events import NS_PER_S

Array = NDArray[np.float64]
F32 = NDArray[np.float32]

_LEAST = 1e-6  # contrast that is as good as none


class Rigid(NamedTuple):
    """A rigid scene as the known motion shows it, at the nodes of `Blend.fine`.

    Attributes:
        flow: (columns, rows, 2, 2) px per window.
        contrast: (columns, rows) around each node, of events warped along it.
        structure: its depths at the lattice's nodes, in travelled distances per window; None where
            the camera only rotates.
    """

    flow: Array
    contrast: Array
    structure: Structure | None = None


class Blend:
    """Blends a lattice's flow with that of a rigid scene, at nodes closer together.

    Args:
        camera: of the working image.
        lattice: of the flow; the nodes of `fine` are three times as close, every third one of the
            lattice's.
        depth_error: standard deviation of a depth that is known nearby, over it.

    Attributes:
        fine: the lattice of what is blended.
    """

    def __init__(self, camera: Camera, lattice: Lattice, depth_error: float) -> None:
        closer = LATTICE.closer
        self._lattice, self._error = lattice, depth_error
        self.fine = replace(
            lattice,
            columns=closer * (lattice.columns - 1) + 1,
            rows=closer * (lattice.rows - 1) + 1,
        )
        self._between = BetweenDepths(self.fine)
        self._contrast = Contrast(self.fine, 1.0)
        self._a, self._b = motion_field(camera, self.fine.pixels)
        usable = np.isfinite(camera.undistort(self.fine.pixels)[0]).all(axis=-1)
        self._usable = usable.reshape(self.fine.columns, self.fine.rows)  # the lens has an inverse
        height, width = self._contrast.image.shape
        zoom, reach = LATTICE.sampling, LATTICE.blend_px
        self._by_column, self._by_row = (
            nearness((np.arange(side) - MARGIN + 0.5 - 0.5 * zoom) / zoom, nodes, reach)
            for side, nodes in zip((width, height), self._between.axes, strict=True)
        )

    def rigid(self, events: WindowEvents, estimate: Estimate, depths: Depths) -> Rigid | None:
        """Tell how the scene moves if nothing in it moves by itself.

        Args:
            events: of the window.
            estimate: of it, with its motion.
            depths: of points, in the pixels of the working image.

        Returns:
            None where the camera travels and no depth is known.
        """
        flow = np.einsum("nij,tj->nti", self._b, rotation_at_ends(estimate))
        structure = None
        if estimate.translation_observable:
            if not depths.weight.any():
                return None
            seconds = (estimate.t_end - estimate.t_start) / NS_PER_S
            rho, near = self._between(replace(depths, inverse_depth=seconds * depths.inverse_depth))
            line = self._a @ estimate.linear
            flow = flow + (rho.reshape(-1, 1) * line)[:, None]
            structure = self._structure(rho, near, (line**2).sum(axis=1).reshape(rho.shape))
        flow = flow.reshape(self.fine.shape)
        return Rigid(flow, self._around(events, flow), structure)

    def _structure(self, rho: Array, near: Array, squared: Array) -> Structure:
        """What the fit may rely on, by inverse depths, how many are known nearby, and |a v|^2."""
        rho, near, squared = (f[:: LATTICE.closer, :: LATTICE.closer] for f in (rho, near, squared))
        variance = (
            self._error * rho
        ) ** 2 * squared + LATTICE.flow_error_px**2  # of the flow, px^2
        return Structure(rho.ravel(), (near / (1 + near) * squared / variance).ravel())

    def start(self, events: WindowEvents, flow: F32, rigid: Rigid) -> F32:
        """What another fit begins with: the rigid scene where the lattice is hardly sharper.

        So it is where no event is near. Arguments as in `__call__`; the nodes are the lattice's.
        """
        own, closer = self._finer(flow), LATTICE.closer
        hardly = rigid.contrast > LATTICE.hardly * self._around(events, own)
        begin = np.where((self._usable & hardly)[:, :, None, None], rigid.flow, own)
        return np.ascontiguousarray(begin[::closer, ::closer], np.float32)

    def __call__(self, events: WindowEvents, flow: F32, rigid: Rigid) -> F32:
        """Blend by the contrast around each node, (columns, rows, 2, 2) px per window of `fine`.

        Args:
            events: of the window.
            flow: of the lattice, (columns, rows, 2, 2) px per window.
            rigid: the scene that it is blended with.
        """
        own = self._finer(flow)
        sharper = np.log(rigid.contrast / self._around(events, own))
        share = self._usable * expit(LATTICE.blend_power * sharper)
        return (own + share[:, :, None, None] * (rigid.flow - own)).astype(np.float32)

    def _finer(self, flow: F32) -> Array:
        """The lattice's flow at the nodes of `fine`."""
        nodes = flow.astype(np.float64).reshape(len(self._lattice.pixels), -1)
        return self._lattice.interpolate(nodes, self.fine.pixels).reshape(self.fine.shape)

    def _around(self, events: WindowEvents, flow: Array) -> Array:
        """Contrast around each node (columns, rows) of the events warped along a flow."""
        self._contrast.sharpen(events, flow.astype(np.float32))
        squares = self._contrast.image.astype(np.float64) ** 2
        return np.asarray(self._by_column @ squares.T @ self._by_row.T + _LEAST)
