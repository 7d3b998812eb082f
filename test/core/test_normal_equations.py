import numpy as np
import pytest

from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.normal_equations import NormalEquations, NotPositiveDefiniteError

LATTICE = Lattice(60, 50, 4, 3, 2)
N = LATTICE.unknowns
BORDER = 6


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
    equations = NormalEquations(LATTICE)
    factor = np.tril(np.triu(rng.normal(size=(N, N)), -LATTICE.bandwidth)) + 4 * np.eye(N)
    matrix = factor @ factor.T
    for d in range(LATTICE.bandwidth + 1):
        equations.band[: N - d, d] = np.diagonal(matrix, -d)
    equations.vector[:] = rng.normal(size=N)
    np.testing.assert_allclose(dense(equations.band), matrix)
    return equations


def border(rng):
    """Second derivatives with and among further unknowns, positive definite as a whole."""
    across = rng.normal(size=(N, BORDER))
    corner = rng.normal(size=(BORDER, BORDER))
    corner = corner @ corner.T + 200 * np.eye(BORDER)
    return across, corner, rng.normal(size=BORDER)


def test_solve_is_the_dense_solution_and_keeps_the_equations(equations):
    band, vector = equations.band.copy(), equations.vector.copy()
    expected = np.linalg.solve(dense(band), vector)
    np.testing.assert_allclose(equations.solve(), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(equations.band, band)
    np.testing.assert_array_equal(equations.vector, vector)


def test_bordered_solution_is_that_of_the_full_system(equations):
    across, corner, corner_vector = border(np.random.default_rng(2))
    full = np.block([[dense(equations.band), across], [across.T, corner]])
    expected = np.linalg.solve(full, np.concatenate([equations.vector, corner_vector]))
    step, further, information = equations.solve_bordered(across, corner, corner_vector)
    np.testing.assert_allclose(step, expected[:N], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(further, expected[N:], rtol=1e-8, atol=1e-10)
    # Information left after marginalising the field: the inverse of the covariance's block.
    covariance = np.linalg.inv(full)[N:, N:]
    np.testing.assert_allclose(information, np.linalg.inv(covariance), rtol=1e-8, atol=1e-8)


def test_a_border_of_nothing_changes_nothing(equations):
    expected = equations.solve()
    step, further, information = equations.solve_bordered(
        np.zeros((N, BORDER)), 2 * np.eye(BORDER), np.arange(BORDER, dtype=float)
    )
    np.testing.assert_allclose(step, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(further, np.arange(BORDER) / 2)
    np.testing.assert_allclose(information, 2 * np.eye(BORDER))


def test_rows_are_weighted_squares_of_residuals(equations):
    """Cost: weight / 2 * (r + normal . step)^2, for each node and time."""
    rng = np.random.default_rng(3)
    nodes, times = LATTICE.columns * LATTICE.rows, LATTICE.times
    normal, weight = rng.normal(size=(nodes, times, 2)), rng.random((nodes, times))
    r = rng.normal(size=(nodes, times))
    matrix, vector = dense(equations.band), equations.vector.copy()
    equations.add_rows(normal, weight, r)
    jacobian = np.zeros((nodes * times, N))
    for k, row in enumerate(normal.reshape(-1, 2)):
        jacobian[k, 2 * k : 2 * k + 2] = row
    weighted = weight.ravel()[:, None] * jacobian
    np.testing.assert_allclose(dense(equations.band), matrix + jacobian.T @ weighted, atol=1e-12)
    np.testing.assert_allclose(equations.vector, vector - weighted.T @ r.ravel(), atol=1e-12)


@pytest.mark.parametrize("times", [2, 3])
def test_node_information_is_that_of_a_flow_constant_in_time(times):
    lattice = Lattice(60, 50, 4, 3, times)
    equations = NormalEquations(lattice)
    block = 2 * times
    rng = np.random.default_rng(4)
    blocks = rng.normal(size=(12, block, block))
    blocks = blocks + np.swapaxes(blocks, 1, 2)
    blocks *= np.abs(np.subtract.outer(np.arange(block) // 2, np.arange(block) // 2)) <= 1
    for d in range(block):
        for j in range(block - d):
            equations.band[j::block, d] = blocks[:, j + d, j]
    same = np.tile(np.eye(2), (times, 1))  # one (u, v) at all times
    np.testing.assert_allclose(equations.node_information(), same.T @ blocks @ same, atol=1e-12)


def test_clear_starts_anew(equations):
    equations.clear()
    assert not equations.band.any() and not equations.vector.any()


def test_no_minimum_is_an_error(equations):
    equations.band[5, 0] = -1.0
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve()
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered(*border(np.random.default_rng(5)))


def test_a_singular_corner_is_an_error(equations):
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered(np.zeros((N, BORDER)), np.zeros((BORDER, BORDER)), np.ones(BORDER))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_an_error(equations, bad):
    equations.vector[3] = bad
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve()
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered(*border(np.random.default_rng(6)))


def test_a_saddle_is_no_minimum(equations):
    with pytest.raises(NotPositiveDefiniteError):
        equations.solve_bordered(np.zeros((N, 2)), -np.eye(2), np.ones(2))
