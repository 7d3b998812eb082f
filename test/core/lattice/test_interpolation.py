"""The compiled interpolation against SciPy's."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.field_kernels import bilinear

PER_PX = np.array([0.05, 0.04], np.float32)


def by_scipy(grid, points):
    where = (points * PER_PX).T
    layers = np.moveaxis(grid, -1, 0)
    return np.stack([map_coordinates(g, where, order=1, mode="nearest") for g in layers], -1)


@pytest.mark.parametrize("shape", [(2, 2, 2), (3, 5, 1), (14, 11, 4)])
def test_values_are_those_of_scipy(shape):
    rng = np.random.default_rng(0)
    grid = rng.normal(size=shape)
    points = rng.uniform(-50, 400, (2000, 2))
    np.testing.assert_allclose(bilinear(grid, points, PER_PX), by_scipy(grid, points), atol=1e-12)
    lattice = Lattice(346, 260, 14, 11)
    values = rng.normal(size=(lattice.columns * lattice.rows, 3))
    found = lattice.interpolate(values.T.copy().T, points)  # whatever the layout in memory
    grid = values.reshape(lattice.columns, lattice.rows, 3)
    np.testing.assert_array_equal(found, bilinear(grid, points, lattice.per_px))


def test_nodes_keep_their_values_and_what_is_not_finite_has_none():
    grid = np.arange(12, dtype=np.float32).reshape(2, 3, 2)
    nodes = np.array([[0, 0], [0, 2], [1, 1], [1, 2]])
    points = np.vstack([nodes / PER_PX.astype(float), [[np.nan, 1], [2, np.inf]]])
    found = bilinear(grid, points, PER_PX)
    np.testing.assert_allclose(found[:4], grid[nodes[:, 0], nodes[:, 1]], atol=1e-5)
    assert np.isnan(found[4:]).all()
