"""Normal equations of the flow lattice with a border for the egomotion, and their numba kernels.

Matrices are in lower band storage: band[j, i - j] is entry (i, j).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from emoflow_ros.core.lattice.cells import Cells, add_cells, add_still_cells
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.field import TIMES, Lattice
from emoflow_ros.core.numerics.banded import (
    NotPositiveDefiniteError,
    eliminate,
    solve_banded,
    substitute_back,
)
from emoflow_ros.core.numerics.jit import njit

Array = NDArray[np.float64]
F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_RIDGE = 1e-3  # px^-2, holds nodes that no event and no neighbour reaches

_compiled = njit(nogil=True)


class NormalEquations:
    """A quadratic model of the cost around a field: step^T H step / 2 - vector^T step.

    Args:
        lattice: of the field; of one time where the field does not change within the window.
        further: number m of unknowns beside the field.

    Attributes:
        vector: (n,) the negative gradient.
        band: (n, bandwidth + 1) H in lower band storage (LAPACK's, transposed):
            band[j, i - j] is entry (i, j).
        border: (n, m) second derivatives by field and further unknowns.
        corner: (m, m) second derivatives by the further unknowns.
        corner_vector: (m,) their negative gradient.
    """

    def __init__(self, lattice: Lattice, further: int) -> None:
        self.lattice = lattice
        self.vector = np.zeros(lattice.unknowns)
        self.band = np.zeros((lattice.unknowns, lattice.bandwidth + 1))
        self.border = np.zeros((lattice.unknowns, further))
        self.corner = np.zeros((further, further))
        self.corner_vector = np.zeros(further)

    def set_up(self, cells: Cells, flow: F32, config: LatticeConfig) -> None:
        """Start anew from a contrast and the prior on a field: smooth up to edges, and in time.

        Args:
            cells: the contrast's derivatives.
            flow: (columns, rows, times, 2) px per window, to linearise at.
            config: weights of the second differences in space and of the differences in time, and
                the second difference (px per window) above which it counts as an edge.
        """
        lattice = self.lattice
        each = TIMES / lattice.times  # a value that does not change stands for both times
        values = flow.reshape(-1, lattice.times, 2).astype(np.float64)
        _set_up(
            *cells, values, lattice.second_differences, each * _RIDGE, each * config.smoothness,
            config.edge_px, config.smoothness_in_time, *self.parts,
        )  # fmt: skip

    @property
    def parts(self) -> tuple[Array, Array, Array, Array, Array]:
        """Vector, band, border, corner and corner_vector, as `constraints` takes them."""
        return self.vector, self.band, self.border, self.corner, self.corner_vector

    def add_rows(self, normal: Array, by_further: Array, weight: Array, r: Array) -> None:
        """Add weighted squares of residuals that each concern one node at one time.

        Args:
            normal: (nodes, times, 2) derivative of each residual by its node's flow.
            by_further: (nodes, times, k + 1) derivative by the k further unknowns of its time,
                and by the one that all times share.
            weight, r: (nodes, times).
        """
        add_rows(normal, by_further, weight, r, *self.parts)

    def solve(self) -> Array:
        """Return the step (n,) to the minimum.

        Raises:
            NotPositiveDefiniteError: there is none.
        """
        step = solve_banded(self.band, self.vector)
        if not np.isfinite(step).all():
            raise NotPositiveDefiniteError
        return step

    def solve_bordered(self) -> tuple[Array, Array]:
        """Solve at once, by the Schur complement, for the field and what is beside it.

        Returns:
            The steps (n,) and (m,).

        Raises:
            NotPositiveDefiniteError: there is no minimum.
        """
        factor, both = self.band.copy(), np.empty((1 + len(self.corner), len(self.vector)))
        both[0], both[1:] = self.vector, self.border.T
        eliminate(factor, both)
        of_field, across = both[0], both[1:]
        products = across @ both.T
        _, others, info = dposv(self.corner - products[:, 1:], self.corner_vector - products[:, 0])
        left = of_field - others @ across
        substitute_back(factor, left)
        if info != 0 or not np.isfinite(left).all():
            raise NotPositiveDefiniteError
        return left, others


@_compiled
def _set_up(
    gradient: F32, curvature: F32, flow: F64, stencils: tuple[tuple[NDArray[np.int64], F64], ...],
    ridge: float, weight: float, limit: float, in_time: float,
    vector: F64, band: F64, border: F64, corner: F64, corner_vector: F64,
) -> None:  # fmt: skip
    """Clear everything, then add contrast, ridge and smoothness; one call, as in `kernels`.

    Args:
        gradient, curvature: of Cells.
        stencils: nodes and coefficients; flow, weight, limit, vector, band: as in `add_stencil`.
        ridge: stiffness of each value.
        in_time: weight as in `add_differences_in_time`.
        border, corner, corner_vector: are cleared.
    """
    vector[:], band[:], border[:], corner[:], corner_vector[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    if flow.shape[1] == 1:
        add_still_cells(gradient, curvature, vector, band)
    else:
        add_cells(gradient, curvature, vector, band)
    for i in range(len(band)):
        band[i, 0] += ridge
    for nodes, coefficients in stencils:
        add_stencil(flow, nodes, coefficients, weight, limit, vector, band)
    add_differences_in_time(flow, in_time, vector, band)


@_compiled
def add_stencil(
    flow: F64, nodes: NDArray[np.int64], coefficients: F64, weight: float, limit: float,
    vector: F64, band: F64,
) -> None:  # fmt: skip
    """Add a robust penalty on linear combinations of neighbouring nodes.

    Charbonnier: weight * T limit^2 * sqrt(1 + |z|^2 / (T limit^2)) with z the combination of
    the flow's (u, v) over all T times, linearised as in iteratively reweighted least squares.

    Args:
        flow: (nodes, times, 2).
        nodes: (M, K) indices of the nodes in each combination.
        coefficients: (K,).
        weight: stiffness of small differences.
        limit: px per window, above which a difference counts as an edge.
        vector: (n,), gets the negative gradient.
        band: (n, bandwidth + 1), lower band storage: band[j, i - j] is entry (i, j).
    """
    times = flow.shape[1]
    each = 2 * times  # unknowns of a node
    values = flow.reshape(-1, each)
    z = np.empty(each)
    for n in range(len(nodes)):
        z[:] = 0.0
        for k in range(nodes.shape[1]):
            for c in range(each):
                z[c] += coefficients[k] * values[nodes[n, k], c]
        squares = 0.0
        for c in range(each):
            squares += z[c] * z[c]
        stiffness = weight / np.sqrt(1 + squares / (times * limit * limit))
        for k in range(nodes.shape[1]):
            i = nodes[n, k] * each
            for c in range(each):
                vector[i + c] -= stiffness * coefficients[k] * z[c]
            for m in range(k + 1):
                j = nodes[n, m] * each
                pair = stiffness * coefficients[k] * coefficients[m]
                for c in range(each):
                    band[min(i, j) + c, abs(i - j)] += pair


@_compiled
def add_differences_in_time(flow: F64, weight: float, vector: F64, band: F64) -> None:
    """Add a quadratic penalty on the flow's change from one time node to the next.

    Args:
        flow: (nodes, times, 2); weight, vector, band as in `add_stencil`.
    """
    nodes, times, _ = flow.shape
    for n in range(nodes):
        for q in range(times - 1):
            for d in range(2):
                j = (n * times + q) * 2 + d
                change = weight * (flow[n, q + 1, d] - flow[n, q, d])
                vector[j] += change
                vector[j + 2] -= change
                band[j, 0] += weight
                band[j + 2, 0] += weight
                band[j, 2] -= weight


@njit(nogil=True, inline="always")  # part of its callers, with their arithmetic
def add_rows(
    normal: F64, by_further: F64, weight: F64, r: F64,
    vector: F64, band: F64, border: F64, corner: F64, corner_vector: F64,
) -> None:  # fmt: skip
    """Add weighted squares of residuals that each concern one node at one time.

    Args:
        normal: (nodes, times, 2) derivative of each residual by its node's flow.
        by_further: (nodes, times, k + 1) derivative by unknowns beside the flow: k of its time, and
            the last one.
        weight, r: (nodes, times).
        vector, band: as in `add_stencil`.
        border: (n, m) second derivatives across.
        corner, corner_vector: (m, m) and (m,), of the other unknowns.
    """
    nodes, times, further = by_further.shape
    last = len(corner_vector) - 1
    at = np.empty(further, np.int64)
    for q in range(times):
        for a in range(further):
            at[a] = q * (further - 1) + a if a < further - 1 else last
        for n in range(nodes):
            if weight[n, q] == 0.0:  # most are, of terms that hold for few nodes
                continue
            i = 2 * (n * times + q)
            x, y = weight[n, q] * normal[n, q, 0], weight[n, q] * normal[n, q, 1]
            vector[i] -= x * r[n, q]
            vector[i + 1] -= y * r[n, q]
            band[i, 0] += x * normal[n, q, 0]
            band[i, 1] += x * normal[n, q, 1]
            band[i + 1, 0] += y * normal[n, q, 1]
            row = by_further[n, q]
            for a in range(further):
                weighted = weight[n, q] * row[a]
                border[i, at[a]] += weighted * normal[n, q, 0]
                border[i + 1, at[a]] += weighted * normal[n, q, 1]
                corner_vector[at[a]] -= weighted * r[n, q]
                for b in range(further):
                    corner[at[a], at[b]] += weighted * row[b]
