"""The compiled interpolation against SciPy's."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from emoflow_ros.core.lattice_kernels import bilinear

PER_PX = np.array([0.05, 0.04], np.float32)


@pytest.mark.parametrize("shape", [(2, 2, 2), (3, 5, 2), (14, 11, 2)])
def test_values_are_those_of_scipy(shape):
    rng = np.random.default_rng(0)
    grid = rng.normal(size=shape).astype(np.float32)
    points = rng.uniform(-50, 400, (2000, 2))
    where = (points * PER_PX).T
    expected = [map_coordinates(grid[..., d], where, order=1, mode="nearest") for d in range(2)]
    np.testing.assert_allclose(bilinear(grid, points, PER_PX), np.stack(expected, -1), atol=1e-6)


def test_nodes_keep_their_values_and_what_is_not_finite_has_none():
    grid = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    nodes = np.array([[0, 0], [0, 2], [1, 1], [1, 2]])
    points = np.vstack([nodes / PER_PX.astype(float), [[np.nan, 1], [2, np.inf]]])
    found = bilinear(grid, points, PER_PX)
    np.testing.assert_allclose(found[:4], grid[nodes[:, 0], nodes[:, 1]], atol=1e-5)
    assert np.isnan(found[4:]).all()
