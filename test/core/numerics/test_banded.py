"""Cholesky factors of band matrices, against dense ones."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from emoflow_ros.core.numerics.banded import (
    NotPositiveDefiniteError,
    eliminate,
    solve_banded,
    substitute_back,
)

SIZE, WIDTH = 30, 5


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def matrix_and_band(
    rng: np.random.Generator, size: int, width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Positive definite, with numbers that mean nothing where the band leaves the matrix."""
    band = rng.normal(size=(size, width))
    band[:, 0] = 6 * width + rng.random(size)  # more than a row's others together
    dense = np.diag(band[:, 0])
    for d in range(1, min(width, size)):
        dense += np.diag(band[: size - d, d], -d) + np.diag(band[: size - d, d], d)
    return dense, band


# The number of columns that are eliminated at once is 4; a band may be wider than the matrix.
SHAPES = [(30, 5), (29, 5), (31, 7), (8, 3), (5, 9), (3, 2), (4, 1), (1, 1)]


@pytest.mark.parametrize(("size", "width"), SHAPES)
@pytest.mark.parametrize("sides", [0, 1, 2, 3])
def test_eliminate_and_substitute_back_solve_the_system(
    rng: np.random.Generator, size: int, width: int, sides: int
) -> None:
    dense, band = matrix_and_band(rng, size, width)
    right = rng.normal(size=(sides, size))
    factor, solution = band.copy(), right.copy()
    eliminate(factor, solution)
    lower = np.linalg.cholesky(dense)
    for d in range(min(width, size)):
        np.testing.assert_allclose(factor[: size - d, d], np.diag(lower, -d), atol=1e-12)
    np.testing.assert_allclose(lower @ solution.T, right.T, atol=1e-12)
    for one in solution:
        substitute_back(factor, one)
    np.testing.assert_allclose(dense @ solution.T, right.T, atol=1e-12)


@pytest.mark.parametrize(("size", "width"), SHAPES)
def test_solve_is_the_dense_solution(rng: np.random.Generator, size: int, width: int) -> None:
    dense, band = matrix_and_band(rng, size, width)
    kept, right = band.copy(), rng.normal(size=size)
    kept_right = right.copy()
    np.testing.assert_allclose(dense @ solve_banded(band, right), right, atol=1e-12)
    np.testing.assert_array_equal(band, kept)
    np.testing.assert_array_equal(right, kept_right)


@pytest.mark.parametrize("pivot", [0.0, -1.0, np.nan])
@pytest.mark.parametrize("at", [0, 7, SIZE - 1])
def test_a_matrix_without_a_factor_is_refused(
    rng: np.random.Generator, pivot: float, at: int
) -> None:
    _, band = matrix_and_band(rng, SIZE, WIDTH)
    band[at, 0] = pivot
    with pytest.raises(NotPositiveDefiniteError):
        solve_banded(band, np.ones(SIZE))
    with pytest.raises(NotPositiveDefiniteError):
        eliminate(band, np.ones((2, SIZE)))


def test_threads_do_not_disturb_each_other(rng: np.random.Generator) -> None:
    dense, band = matrix_and_band(rng, SIZE, WIDTH)

    def work(right: np.ndarray) -> np.ndarray:
        for _ in range(50):
            factor, solution = band.copy(), right[None].copy()
            eliminate(factor, solution)
            substitute_back(factor, solution[0])
        np.testing.assert_array_equal(solution[0], solve_banded(band, right))
        return solution[0]

    rights = [rng.normal(size=SIZE) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for right, found in zip(rights, pool.map(work, rights), strict=True):
            np.testing.assert_allclose(dense @ found, right, atol=1e-12)
