"""Cholesky factors of band matrices, against dense ones."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from emoflow_ros.core.banded import BandFactor, NotPositiveDefiniteError, solve_banded

SIZE, WIDTH = 30, 4


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def matrix_and_band(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    band = rng.normal(size=(SIZE, WIDTH + 1))
    band[:, 0] = 8 + rng.random(SIZE)  # more than a row's others together
    dense = np.diag(band[:, 0])
    for d in range(1, WIDTH + 1):
        dense += np.diag(band[: SIZE - d, d], -d) + np.diag(band[: SIZE - d, d], d)
    return dense, band


def test_forward_and_backward_solve_the_system(rng: np.random.Generator) -> None:
    dense, band = matrix_and_band(rng)
    kept = band.copy()
    right = np.asfortranarray(rng.normal(size=(SIZE, 3)))
    solution = right.copy(order="F")
    factor = BandFactor(band)
    factor.forward(solution)
    np.testing.assert_allclose(np.linalg.cholesky(dense) @ solution, right, atol=1e-12)
    factor.backward(solution)
    np.testing.assert_allclose(dense @ solution, right, atol=1e-12)
    np.testing.assert_array_equal(band, kept)


def test_solve_is_the_dense_solution(rng: np.random.Generator) -> None:
    dense, band = matrix_and_band(rng)
    kept, right = band.copy(), rng.normal(size=SIZE)
    kept_right = right.copy()
    np.testing.assert_allclose(dense @ solve_banded(band, right), right, atol=1e-12)
    np.testing.assert_array_equal(band, kept)
    np.testing.assert_array_equal(right, kept_right)


@pytest.mark.parametrize("pivot", [0.0, -1.0])
def test_a_matrix_without_a_factor_is_refused(rng: np.random.Generator, pivot: float) -> None:
    _, band = matrix_and_band(rng)
    band[7, 0] = pivot
    with pytest.raises(NotPositiveDefiniteError):
        solve_banded(band, np.ones(SIZE))
    with pytest.raises(NotPositiveDefiniteError):
        BandFactor(band)


def test_threads_do_not_disturb_each_other(rng: np.random.Generator) -> None:
    dense, band = matrix_and_band(rng)

    def work(right: np.ndarray) -> np.ndarray:
        for _ in range(50):
            solution = right.copy(order="F")
            factor = BandFactor(band)
            factor.forward(solution)
            factor.backward(solution)
            alone = solve_banded(band, right[:, 0])
        np.testing.assert_allclose(alone, solution[:, 0], atol=1e-12)
        return solution

    rights = [np.asfortranarray(rng.normal(size=(SIZE, 2))) for _ in range(4)]
    with ThreadPoolExecutor(4) as pool:
        for right, found in zip(rights, pool.map(work, rights), strict=True):
            np.testing.assert_allclose(dense @ found, right, atol=1e-12)
