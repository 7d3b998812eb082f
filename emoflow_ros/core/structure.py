"""Structure of the scene, carried from window to window as inverse depth at the nodes.

One window tells rotation and sideways translation apart only by the scene's relief, and
poorly. The relief stays while the motion changes: what earlier windows know of it turns
the translational flow u - b w from a free length along the epipolar line into a known one,
speed * rho * |a v|, but for the speed, which no single camera knows.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.belief import INFORMATION_EXCESS
from emoflow_ros.core.egomotion import NodeEpipolar
from emoflow_ros.core.lattice import Lattice

Array = NDArray[np.float64]

_FLOW_ERROR_PX = 0.15  # systematic error of a node's flow, the same in many windows
_MAX_APPROACH = 0.2  # depths per window


@dataclass(frozen=True)
class Structure:
    """Inverse depths with their certainty.

    Attributes:
        inverse_depth: (nodes,) for a unit v, in travelled distances per window.
        information: (nodes,) inverse variances.
    """

    inverse_depth: Array
    information: Array

    @classmethod
    def observe(
        cls,
        epipolar: NodeEpipolar,
        flow: Array,
        motion: tuple[Array, Array],
        evidence: Array,
        predicted: "Structure | None",
    ) -> "Structure":
        """Read it from a fitted flow.

        Args:
            epipolar: the lattice's constraint.
            flow: (nodes, 2) px per window.
            motion: w (3,) rad per window and v (3,) unit.
            evidence: (nodes, 2, 2) the events' information on the flow.
            predicted: what the fit already knew, and may count on again.
        """
        w, v = motion
        line, squared = _lines(epipolar, v)
        translational = flow - epipolar.b @ w
        inverse_depth = (translational * line).sum(-1) / squared
        along = ((line[:, None] @ evidence)[:, 0] * line).sum(-1)
        information = epipolar.usable * along / INFORMATION_EXCESS
        if predicted is not None:
            information = information + predicted.information
        return cls(inverse_depth, information)

    def predict(
        self,
        lattice: Lattice,
        epipolar: NodeEpipolar,
        flow: Array,
        windows: float,
        v: Array,
        drift: float,
    ) -> "Structure":
        """Move it along with the scene into a later window.

        Args:
            lattice: the flow's.
            epipolar: the lattice's constraint.
            flow: (nodes, 2) px per window, now.
            windows: how far ahead, in windows.
            v: (3,) unit direction of travel.
            drift: relative change of depth that is expected anyway.
        """
        _, squared = _lines(epipolar, v)
        error = (drift * self.inverse_depth) ** 2 + _FLOW_ERROR_PX**2 / squared
        certainty = 1 / (1 / np.maximum(self.information, 1e-9) + error)
        source = lattice.pixels - windows * flow
        known = lattice.interpolate(certainty, source)
        inverse_depth = lattice.interpolate(certainty * self.inverse_depth, source) / known
        # A scene that comes closer grows: Z' = Z - v_z.
        approach = np.clip(windows * inverse_depth * v[2], -_MAX_APPROACH, _MAX_APPROACH)
        inside = ((source >= 0) & (source <= lattice.pixels[-1])).all(axis=-1)
        return Structure(inverse_depth * (1 + approach), np.where(inside, known, 1e-9))


def _lines(epipolar: NodeEpipolar, v: Array) -> tuple[Array, Array]:
    """Epipolar lines a v (nodes, 2) and their squared norms, never zero."""
    line = epipolar.a @ v
    return line, (line**2).sum(-1) + epipolar.soft**2
