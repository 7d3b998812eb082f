"""Inverse depths between the points where they are known: means, weighted by nearness.

The kernel regression of Nadaraya, Theory of Probability and Its Applications, 1964.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.refinement import Depths
from emoflow_ros.core.lattice.settings import LATTICE

Array = NDArray[np.float64]


class BetweenDepths:
    """Finds inverse depths at the nodes of a lattice.

    Args:
        lattice: whose nodes these are.

    Attributes:
        axes: places of its columns and rows, px.
    """

    def __init__(self, lattice: Lattice) -> None:
        self._lattice = lattice
        self.axes = (
            np.linspace(0, lattice.width - 1, lattice.columns),
            np.linspace(0, lattice.height - 1, lattice.rows),
        )
        self._spreads = [
            (weight, *(_spread(nodes, reach) for nodes in self.axes))
            for reach, weight in LATTICE.depth_reaches
        ]

    def __call__(self, depths: Depths) -> tuple[Array, Array]:
        """Inverse depths (columns, rows), and how many known ones are near, by weight.

        Of two that differ the farther one counts more: the edge between them is the nearer
        object's, which ends there, and most of what lies around is behind it.

        Args:
            depths: of points in the lattice's pixels; one of them at least has a weight.
        """
        shares = _shares(depths.points, self._lattice)
        found, near = self._between(depths, shares)
        around = self._lattice.interpolate(found.reshape(-1, 1), depths.points)[:, 0]
        farther = around / np.maximum(depths.inverse_depth, np.finfo(float).tiny)
        counts = np.clip(farther, 1 / LATTICE.farther, LATTICE.farther) ** 2
        return self._between(replace(depths, weight=depths.weight * counts), shares)[0], near

    def _between(self, depths: Depths, shares: csr_array) -> tuple[Array, Array]:
        """The same, all counting alike.

        Points are handed on to the nodes around them first: there may be a thousand.
        """
        known = np.stack([np.ones_like(depths.inverse_depth), depths.inverse_depth])
        at_nodes = np.ascontiguousarray((shares @ (depths.weight * known).T).T)
        at_nodes = at_nodes.reshape(-1, self._lattice.columns, self._lattice.rows)
        number, total = sum(
            weight * (by_column @ at_nodes @ by_row) for weight, by_column, by_row in self._spreads
        )
        found = total / np.maximum(number, np.finfo(float).tiny)
        return found, 2 * np.pi * LATTICE.depth_reaches[0][0] ** 2 * number


def nearness(places: Array, nodes: Array, reach: float) -> Array:
    """Gaussian weights (nodes, places) of the distance between nodes and places along an axis."""
    weights = np.exp(-0.5 * ((nodes[:, None] - places) / reach) ** 2)
    return np.asarray(weights / (np.sqrt(2 * np.pi) * reach))


def _spread(nodes: Array, reach: float) -> Array:
    """Gaussian weights (nodes, nodes) for what was handed on to the nodes around a point.

    Handing on is a spread itself, of a sixth of the squared distance of the nodes.
    """
    apart = nodes[1] - nodes[0]
    return nearness(nodes, nodes, float(np.sqrt(max(reach**2 - apart**2 / 6, apart**2 / 4))))


def _shares(points: Array, lattice: Lattice) -> csr_array:
    """Matrix (nodes, N) that hands points (N, 2) px on to the four nodes around each."""
    most = np.array([lattice.columns, lattice.rows]) - 1
    place = np.clip(points * lattice.per_px, 0, most)
    first = np.minimum(place.astype(int), most - 1)
    node, share = [], []
    for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
        near = 1 - np.abs(place - first - corner)
        column, row = (first + corner).T
        node.append(column * lattice.rows + row)
        share.append(near[:, 0] * near[:, 1])
    which = np.tile(np.arange(len(points)), 4)
    shape = (lattice.columns * lattice.rows, len(points))
    return csr_array((np.concatenate(share), (np.concatenate(node), which)), shape=shape)
