"""What is made of the cells' sums, against the normal equations that they add up to."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.lattice.cells import PAIR, PAIRS_OF_NODES, Cells, add_cells, add_still_cells
from emoflow_ros.core.lattice.field import Lattice

LATTICE = Lattice(60, 50, 4, 3)
N = LATTICE.unknowns
NODES = N // 4


@pytest.fixture
def cells() -> Cells:
    rng = np.random.default_rng(1)
    gradient = rng.normal(size=(3, 2, 2, 8)).astype(np.float32)
    return Cells(gradient, rng.normal(size=(3, 2, PAIRS_OF_NODES, 3)).astype(np.float32))


def equations(cells: Cells):
    """The vector (n,) and the matrix (n, n), pair by pair."""
    vector, matrix = np.zeros(N), np.zeros((N, N))
    for c, r in np.ndindex(3, 2):
        unknowns = [
            2 * (((c + (a >> 2)) * LATTICE.rows + r + (a >> 1 & 1)) * 2 + (a & 1)) for a in range(8)
        ]
        for a, i in enumerate(unknowns):
            vector[i : i + 2] += cells.gradient[c, r, :, a]
            for b, j in enumerate(unknowns):
                xx, xy, yy = cells.curvature[c, r, PAIR[a, b]]
                matrix[i : i + 2, j : j + 2] += [[xx, xy], [xy, yy]]
    return vector, matrix


def test_they_add_up_to_vector_and_band(cells):
    vector, matrix = equations(cells)
    found, band = np.ones(N), np.zeros((N, LATTICE.bandwidth + 1))
    add_cells(*cells, found, band)
    np.testing.assert_allclose(found, 1 + vector, atol=1e-12)
    for d in range(LATTICE.bandwidth + 1):
        np.testing.assert_allclose(band[: N - d, d], np.diagonal(matrix, -d), atol=1e-12)


def test_a_flow_constant_in_time_adds_up_to_half_as_many_unknowns(cells):
    vector, matrix = equations(cells)
    same = np.kron(np.eye(NODES), np.tile(np.eye(2), (2, 1)))  # (n, n / 2)
    still = replace(LATTICE, times=1)
    found, band = np.zeros(N // 2), np.zeros((N // 2, still.bandwidth + 1))
    add_still_cells(*cells, found, band)
    np.testing.assert_allclose(found, same.T @ vector, atol=1e-5)
    expected = same.T @ matrix @ same
    for d in range(still.bandwidth + 1):
        np.testing.assert_allclose(band[: N // 2 - d, d], np.diagonal(expected, -d), atol=1e-5)


def test_node_information_is_that_of_a_flow_constant_in_time(cells):
    _, matrix = equations(cells)
    same = np.tile(np.eye(2), (2, 1))  # one (u, v) at both times
    expected = [same.T @ matrix[4 * n : 4 * n + 4, 4 * n : 4 * n + 4] @ same for n in range(NODES)]
    np.testing.assert_allclose(cells.node_information(), expected, atol=1e-5)


def test_a_common_shift_meets_the_sums_of_all_derivatives(cells):
    vector, matrix = equations(cells)
    common = np.tile(np.eye(2), (N // 2, 1))
    force, stiffness = cells.of_common_shift()
    np.testing.assert_allclose(force, common.T @ vector, atol=1e-5)
    np.testing.assert_allclose(stiffness, common.T @ matrix @ common, atol=1e-4)


@pytest.mark.parametrize("unknowns", [3, 6])
def test_projection_on_the_unknowns_of_a_flow_constant_in_time(cells, unknowns):
    vector, matrix = equations(cells)
    by_unknown = np.random.default_rng(2).normal(size=(NODES, 2, unknowns))
    rows = np.repeat(by_unknown[:, None], 2, axis=1).reshape(N, unknowns)
    force, curvature = cells.project(by_unknown)
    np.testing.assert_allclose(force, rows.T @ vector, atol=1e-4)
    np.testing.assert_allclose(curvature, rows.T @ matrix @ rows, atol=1e-4)
