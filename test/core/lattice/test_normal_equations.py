from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.lattice.cells import Cells, add_cells, add_still_cells
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.normal_equations import NormalEquations, NotPositiveDefiniteError

LATTICE = Lattice(60, 50, 4, 3, 2)
N = LATTICE.unknowns
BORDER = 7  # three at each of two times, and one more
NOTHING = Cells.empty(LATTICE.columns, LATTICE.rows)


def dense(band):
    n = len(band)
    matrix = np.zeros((n, n))
    for d in range(band.shape[1]):
        at = np.arange(n - d)
        matrix[at + d, at] = matrix[at, at + d] = band[: n - d, d]
    return matrix


@pytest.fixture
def equations():
    """Random positive definite equations that fill the band."""
    rng = np.random.default_rng(1)
    equations = NormalEquations(LATTICE, BORDER)
    factor = np.tril(np.triu(rng.normal(size=(N, N)), -LATTICE.bandwidth)) + 4 * np.eye(N)
    matrix = factor @ factor.T
    for d in range(LATTICE.bandwidth + 1):
        equations.band[: N - d, d] = np.diagonal(matrix, -d)
    equations.vector[:] = rng.normal(size=N)
    np.testing.assert_allclose(dense(equations.band), matrix)
    return equations


def add_border(equations, rng):
    """Second derivatives with and among further unknowns, positive definite as a whole."""
    corner = rng.normal(size=(BORDER, BORDER))
    equations.border[:] = rng.normal(size=(N, BORDER))
    equations.corner[:] = corner @ corner.T + 200 * np.eye(BORDER)
    equations.corner_vector[:] = rng.normal(size=BORDER)


def test_solve_is_the_dense_solution_and_keeps_the_equations(equations):
    band, vector = equations.band.copy(), equations.vector.copy()
    expected = np.linalg.solve(dense(band), vector)
    np.testing.assert_allclose(equations.solve(), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(equations.band, band)
    np.testing.assert_array_equal(equations.vector, vector)


def test_bordered_solution_is_that_of_the_full_system(equations):
    add_border(equations, np.random.default_rng(2))
    equations.corner += 1e4 * np.eye(BORDER)  # known from elsewhere
    border = equations.border
    full = np.block([[dense(equations.band), border], [border.T, equations.corner]])
    expected = np.linalg.solve(full, np.append(equations.vector, equations.corner_vector))
    step, others = equations.solve_bordered()
    np.testing.assert_allclose(step, expected[:N], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(others, expected[N:], rtol=1e-8, atol=1e-10)


def test_a_border_of_nothing_changes_nothing(equations):
    expected = equations.solve()
    equations.corner[:] = 2 * np.eye(BORDER)
    equations.corner_vector[:] = np.arange(BORDER)
    step, further = equations.solve_bordered()
    np.testing.assert_allclose(step, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(further, np.arange(BORDER) / 2)


def test_rows_are_weighted_squares_of_residuals(equations):
    """Cost: weight / 2 * (r + normal . step + by_further . further)^2, for each node and time."""
    rng = np.random.default_rng(3)
    nodes, times = LATTICE.columns * LATTICE.rows, LATTICE.times
    normal, weight = rng.normal(size=(nodes, times, 2)), rng.random((nodes, times))
    by_further, r = rng.normal(size=(nodes, times, 4)), rng.normal(size=(nodes, times))
    matrix, vector = dense(equations.band), equations.vector.copy()
    add_border(equations, rng)
    border, corner = equations.border.copy(), equations.corner.copy()
    corner_vector = equations.corner_vector.copy()
    equations.add_rows(normal, by_further, weight, r)
    jacobian = np.zeros((nodes * times, N))
    for k, row in enumerate(normal.reshape(-1, 2)):
        jacobian[k, 2 * k : 2 * k + 2] = row
    further, residual = np.zeros((nodes, times, BORDER)), r.ravel()
    for q in range(times):
        further[:, q, 3 * q : 3 * q + 3], further[:, q, -1] = (
            by_further[:, q, :3],
            by_further[:, q, 3],
        )
    further = further.reshape(-1, BORDER)
    weighted = weight.ravel()[:, None] * jacobian
    on_further = weight.ravel()[:, None] * further
    for found, expected in (
        (dense(equations.band), matrix + jacobian.T @ weighted),
        (equations.vector, vector - weighted.T @ residual),
        (equations.border, border + weighted.T @ further),
        (equations.corner, corner + on_further.T @ further),
        (equations.corner_vector, corner_vector - on_further.T @ residual),
    ):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_smoothness_of_a_flow_constant_in_time_is_that_of_both_times():
    flow = np.random.default_rng(8).normal(size=(4, 3, 1, 2)).astype(np.float32)
    config = LatticeConfig()
    still, both = NormalEquations(replace(LATTICE, times=1), 0), NormalEquations(LATTICE, 0)
    still.set_up(NOTHING, flow, config)
    both.set_up(NOTHING, np.repeat(flow, 2, axis=2), config)
    same = np.kron(np.eye(12), np.tile(np.eye(2), (2, 1)))
    np.testing.assert_allclose(still.vector, same.T @ both.vector, atol=1e-12)
    np.testing.assert_allclose(dense(still.band), same.T @ dense(both.band) @ same, atol=1e-9)


def test_set_up_starts_anew(equations):
    rng = np.random.default_rng(7)
    add_border(equations, rng)
    cells = Cells(*(rng.normal(size=part.shape).astype(np.float32) for part in NOTHING))
    flow = rng.normal(size=LATTICE.shape).astype(np.float32)
    fresh = NormalEquations(LATTICE, BORDER)
    for one in (equations, fresh):
        one.set_up(cells, flow, LatticeConfig())
    np.testing.assert_array_equal(equations.band, fresh.band)
    np.testing.assert_array_equal(equations.vector, fresh.vector)
    for part in (equations.border, equations.corner, equations.corner_vector):
        assert not part.any()


@pytest.mark.parametrize("times", [1, 2])
def test_set_up_adds_contrast_and_smoothness(times):
    rng = np.random.default_rng(9)
    cells = Cells(*(rng.normal(size=part.shape).astype(np.float32) for part in NOTHING))
    flow = rng.normal(size=LATTICE.shape).astype(np.float32)[:, :, :times]
    smooth, both = (NormalEquations(replace(LATTICE, times=times), 0) for _ in range(2))
    smooth.set_up(NOTHING, flow, LatticeConfig())
    both.set_up(cells, flow, LatticeConfig())
    vector, band = np.zeros_like(smooth.vector), np.zeros_like(smooth.band)
    (add_cells if times == 2 else add_still_cells)(*cells, vector, band)
    np.testing.assert_allclose(both.vector, vector + smooth.vector, atol=1e-12)
    np.testing.assert_allclose(both.band, band + smooth.band, atol=1e-12)


def test_no_minimum_is_an_error(equations):
    equations.band[5, 0] = -1.0
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve()
    add_border(equations, np.random.default_rng(5))
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered()


def test_a_singular_corner_is_an_error(equations):
    equations.corner_vector[:] = 1.0
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_an_error(equations, bad):
    equations.vector[3] = bad
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve()
    add_border(equations, np.random.default_rng(6))
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered()


def test_a_saddle_is_no_minimum(equations):
    equations.corner[:] = -np.eye(BORDER)
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered()
