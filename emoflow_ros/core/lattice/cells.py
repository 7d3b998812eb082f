"""A contrast's derivatives, summed within each cell of a lattice, and what is made of them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from emoflow_ros.core.numerics.jit import njit

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# The eight nodes of a cell in x, y and time: time innermost, columns outermost.
_NODES = np.array([(a >> 2, a >> 1 & 1, a & 1) for a in range(8)])
# Products of two nodes' weights: 27 different ones, by the sum of the nodes' places.
PAIR = (_NODES[:, None] + _NODES) @ (9, 3, 1)
PAIRS_OF_NODES = 27
_TIMES_EACH = np.bincount(PAIR.ravel())  # how many pairs of nodes have each product

_compiled = njit(nogil=True)


class Cells(NamedTuple):
    """Gradient and curvature of a contrast in each cell of a lattice of two times.

    Attributes:
        gradient: (columns - 1, rows - 1, 2, 8) by u and v at the cell's nodes, counted with time
            innermost and the column outermost.
        curvature: (columns - 1, rows - 1, 27, 3) negative second derivatives xx, xy and yy, for
            each product of two nodes' weights: PAIR tells which.
    """

    gradient: F32
    curvature: F32

    @classmethod
    def empty(cls, columns: int, rows: int) -> "Cells":
        """Make room for the cells of a lattice of so many nodes."""
        cells = columns - 1, rows - 1
        return cls(np.zeros((*cells, 2, 8), "f4"), np.zeros((*cells, PAIRS_OF_NODES, 3), "f4"))

    def node_information(self) -> F64:
        """Curvature by a flow constant over the window, (nodes, 2, 2), neighbours fixed."""
        return _node_information(self.curvature)

    def of_common_shift(self) -> tuple[F64, F64]:
        """Gradient (2,) and curvature (2, 2) by a flow that all nodes share."""
        return _of_common_shift(self.gradient, self.curvature)

    def project(self, by_unknown: F64) -> tuple[F64, F64]:
        """Gradient (m,) and curvature (m, m) by the unknowns of a flow constant over the window.

        Args:
            by_unknown: (nodes, 2, m) derivatives of the flow.
        """
        return _project(self.gradient, self.curvature, by_unknown)


@_compiled
def add_cells(gradient: F32, curvature: F32, vector: F64, band: F64) -> None:
    """Add Cells to a vector (n,) and a band matrix (n, width) of normal_equations."""
    cells_x, cells_y = gradient.shape[:2]
    rows = cells_y + 1
    offset = np.empty(8, np.int64)
    for c in range(cells_x):
        for r in range(cells_y):
            for a in range(8):
                column, row = c + (a >> 2), r + ((a >> 1) & 1)
                offset[a] = 2 * ((column * rows + row) * 2 + (a & 1))
            g, h = gradient[c, r], curvature[c, r]
            for a in range(8):
                i = offset[a]
                vector[i] += g[0, a]
                vector[i + 1] += g[1, a]
                for b in range(a + 1):  # offsets grow with the node: the lower triangle
                    j, pair = offset[b], PAIR[a, b]
                    d = i - j
                    band[j, d] += h[pair, 0]
                    band[j + 1, d] += h[pair, 2]
                    band[j, d + 1] += h[pair, 1]
                    if b < a:
                        band[j + 1, d - 1] += h[pair, 1]


@_compiled
def add_still_cells(gradient: F32, curvature: F32, vector: F64, band: F64) -> None:
    """Add Cells for a flow constant over the window: to a vector (n / 2,) and its matrix."""
    cells_x, cells_y = gradient.shape[:2]
    rows = cells_y + 1
    for c in range(cells_x):
        for r in range(cells_y):
            g, h = gradient[c, r], curvature[c, r]
            for a in range(4):
                i = 2 * ((c + (a >> 1)) * rows + r + (a & 1))
                vector[i] += g[0, 2 * a] + g[0, 2 * a + 1]
                vector[i + 1] += g[1, 2 * a] + g[1, 2 * a + 1]
                for b in range(a + 1):
                    j = 2 * ((c + (b >> 1)) * rows + r + (b & 1))
                    d = i - j
                    xx, xy, yy = _still(h, 9 * ((a >> 1) + (b >> 1)) + 3 * ((a & 1) + (b & 1)))
                    band[j, d] += xx
                    band[j + 1, d] += yy
                    band[j, d + 1] += xy
                    if b < a:
                        band[j + 1, d - 1] += xy


@_compiled
def _node_information(curvature: F32) -> F64:
    cells_x, cells_y = curvature.shape[:2]
    rows = cells_y + 1
    result = np.zeros(((cells_x + 1) * rows, 2, 2))
    for c in range(cells_x):
        for r in range(cells_y):
            for column in range(2):
                for row in range(2):
                    pair = 18 * column + 6 * row
                    node = result[(c + column) * rows + r + row]
                    xx, xy, yy = _still(curvature[c, r], pair)
                    node[0, 0] += xx
                    node[0, 1] += xy
                    node[1, 0] += xy
                    node[1, 1] += yy
    return result


@_compiled
def _of_common_shift(gradient: F32, curvature: F32) -> tuple[F64, F64]:
    force, total = np.zeros(2), np.zeros((2, 2))
    for c in range(gradient.shape[0]):
        for r in range(gradient.shape[1]):
            for d in range(2):
                for a in range(8):
                    force[d] += gradient[c, r, d, a]
            for pair in range(PAIRS_OF_NODES):
                cell = curvature[c, r, pair]
                total[0, 0] += _TIMES_EACH[pair] * cell[0]
                total[0, 1] += _TIMES_EACH[pair] * cell[1]
                total[1, 1] += _TIMES_EACH[pair] * cell[2]
    total[1, 0] = total[0, 1]
    return force, total


@_compiled
def _still(cell: F32, pair: int) -> tuple[float, float, float]:
    """Sum over both nodes' times: one at each time, and twice the product of the two times."""
    xx = cell[pair, 0] + 2 * cell[pair + 1, 0] + cell[pair + 2, 0]
    xy = cell[pair, 1] + 2 * cell[pair + 1, 1] + cell[pair + 2, 1]
    yy = cell[pair, 2] + 2 * cell[pair + 1, 2] + cell[pair + 2, 2]
    return xx, xy, yy


@_compiled
def _project(gradient: F32, curvature: F32, by_unknown: F64) -> tuple[F64, F64]:
    cells_x, cells_y = gradient.shape[:2]
    rows, unknowns = cells_y + 1, by_unknown.shape[2]
    force, total = np.zeros(unknowns), np.zeros((unknowns, unknowns))
    moved = np.empty((2, unknowns))
    for c in range(cells_x):
        for r in range(cells_y):
            g, h = gradient[c, r], curvature[c, r]
            for a in range(4):
                mine = by_unknown[(c + (a >> 1)) * rows + r + (a & 1)]
                moved[:] = 0.0
                for b in range(4):
                    its = by_unknown[(c + (b >> 1)) * rows + r + (b & 1)]
                    xx, xy, yy = _still(h, 9 * ((a >> 1) + (b >> 1)) + 3 * ((a & 1) + (b & 1)))
                    for k in range(unknowns):
                        moved[0, k] += xx * its[0, k] + xy * its[1, k]
                        moved[1, k] += xy * its[0, k] + yy * its[1, k]
                x, y = g[0, 2 * a] + g[0, 2 * a + 1], g[1, 2 * a] + g[1, 2 * a + 1]
                for k in range(unknowns):
                    force[k] += mine[0, k] * x + mine[1, k] * y
                    for m in range(unknowns):
                        total[k, m] += mine[0, k] * moved[0, m] + mine[1, k] * moved[1, m]
    return force, total
