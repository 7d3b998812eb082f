"""The fast path against slow references that say the same thing in plain NumPy and SciPy."""

import numpy as np
import pytest
from scipy.linalg import eigh

from emoflow_ros.core.lattice import derivatives, kernels, normal_equations
from emoflow_ros.core.lattice.cells import Cells, add_cells
from emoflow_ros.core.lattice.field import Lattice
from emoflow_ros.core.lattice.field_kernels import material_derivative
from emoflow_ros.core.lattice.window_events import CellEvents
from emoflow_ros.core.numerics.smoothing import gaussian, outwards, smooth

LATTICE = Lattice(120, 90, 5, 4)
EVENTS = 2000


@pytest.fixture
def rng():
    return np.random.default_rng(1)


def random_events(rng, parts: int = 4, repeat: int = 1) -> CellEvents:
    """Sorted events; corners, the first and the last moment included."""
    count = EVENTS // repeat
    x = rng.integers(0, 120, count).astype(np.float32)
    y = rng.integers(0, 90, count).astype(np.float32)
    s = rng.random(count, np.float32)
    x[:4], y[:4], s[:4] = [0, 119, 0, 119], [0, 0, 89, 89], [0, 1, 1, 0]
    columns = (x, y, s, rng.normal(size=count).astype(np.float32))
    return CellEvents.of(*(np.repeat(c, repeat) for c in columns), LATTICE, parts)


def node_weights(x, y, s):
    """Dense trilinear weights (N, columns, rows, times) in double precision."""

    def hats(position, count):
        return np.maximum(0, 1 - np.abs(position[:, None] - np.arange(count)))

    per_px = LATTICE.per_px.astype(np.float64)
    hats_x = hats(x * per_px[0], LATTICE.columns)
    hats_y = hats(y * per_px[1], LATTICE.rows)
    hats_s = hats(s * (LATTICE.times - 1.0), LATTICE.times)
    return np.einsum("ni,nj,nk->nijk", hats_x, hats_y, hats_s)


def voted(position, weights, scale, shape):
    """Bilinear votes; the sensor's pixel (0, 0) has its centre at margin + scale / 2."""
    image = np.zeros(shape)
    at = kernels.MARGIN + (position.astype(np.float64) + 0.5) * scale - 0.5
    inside = (at[0] >= 1) & (at[1] >= 1) & (at[0] < shape[1] - 2) & (at[1] < shape[0] - 2)
    at, weights = at[:, inside], weights[inside]
    (j, i), (fx, fy) = np.floor(at).astype(int), at % 1
    for di, dj, share in (
        (0, 0, (1 - fx) * (1 - fy)), (0, 1, fx * (1 - fy)), (1, 0, (1 - fx) * fy), (1, 1, fx * fy)
    ):  # fmt: skip
        np.add.at(image, (i + di, j + dj), weights * share)
    return image


def dense(band):
    """Symmetric matrix of lower band storage."""
    n = len(band)
    matrix = np.zeros((n, n))
    for d in range(band.shape[1]):
        at = np.arange(n - d)
        matrix[at + d, at] = matrix[at, at + d] = band[: n - d, d]
    return matrix


@pytest.mark.parametrize("ref", [0.0, 0.5, 1.0])
def test_warp(rng, ref):
    events = random_events(rng)
    x, y, s = events.x, events.y, events.s
    flow = rng.normal(scale=8, size=LATTICE.shape).astype(np.float32)
    acceleration = rng.normal(scale=3, size=(5, 4, 2)).astype(np.float32)
    out = np.empty((2, EVENTS), np.float32)
    kernels.warp(events, ref, flow, acceleration, out)
    weights = node_weights(x, y, s)
    u = np.einsum("nijk,ijkd->dn", weights, flow)
    a = np.einsum("nijk,ijd->dn", weights, acceleration)
    dt = ref - s
    np.testing.assert_allclose(out, np.stack([x, y]) + dt * u + 0.5 * dt**2 * a, atol=5e-5)


@pytest.mark.parametrize("scale", [0.25, 0.5, 1.0])
@pytest.mark.parametrize("parts", [1, 3])
def test_vote(rng, scale, parts):
    position = rng.uniform(-40, 160, (2, EVENTS)).astype(np.float32)  # many are far outside
    weights = rng.normal(size=EVENTS).astype(np.float32)
    images = np.full((parts, int(114 * scale) + 1, int(144 * scale) + 1), 7, np.float32)
    part = rng.integers(0, parts, EVENTS).astype(np.int32)
    kernels.vote(position, weights, part, scale, images)
    for k, image in enumerate(images):
        expected = voted(position[:, part == k], weights[part == k], scale, image.shape)
        np.testing.assert_allclose(image, expected, atol=5e-4)


def test_a_vote_on_a_pixel_falls_there():
    images = np.zeros((1, 114, 144), np.float32)
    at, first = np.array([[30.0], [20.0]], np.float32), np.zeros(1, np.int32)
    kernels.vote(at, np.float32([2.5]), first, 1.0, images)
    image = images[0]
    assert image[20 + kernels.MARGIN, 30 + kernels.MARGIN] == 2.5
    assert np.count_nonzero(image) == 1


def slow_pull(events, ref, position, potentials, scale):
    """Gradient (n,) and curvature (n, n) of the lattice, event by event."""
    n = LATTICE.unknowns
    gradient, curvature = np.zeros(n), np.zeros((n, n))
    s, weights = events.s, events.weights
    basis = node_weights(events.x, events.y, (s + ref) / 2).reshape(EVENTS, -1)
    at = kernels.MARGIN + (position.astype(np.float64) + 0.5) * scale - 0.5
    for k in range(EVENTS):
        p = potentials[events.part[k]].astype(np.float64)
        (j, i), (fx, fy) = np.floor(at[:, k]).astype(int), at[:, k] % 1
        if min(at[:, k]) < 1 or at[0, k] >= p.shape[1] - 2 or at[1, k] >= p.shape[0] - 2:
            continue
        dt = (ref - s[k]) * scale
        slope = [
            (1 - fy) * (p[i, j + 1] - p[i, j]) + fy * (p[i + 1, j + 1] - p[i + 1, j]),
            (1 - fx) * (p[i + 1, j] - p[i, j]) + fx * (p[i + 1, j + 1] - p[i, j + 1]),
        ]
        gradient += np.outer(basis[k], weights[k] * dt * np.array(slope)).ravel()
        j, i = np.floor(at[:, k] + 0.5).astype(int)
        xx = p[i, j - 1] - 2 * p[i, j] + p[i, j + 1]
        yy = p[i - 1, j] - 2 * p[i, j] + p[i + 1, j]
        xy = (p[i + 1, j + 1] + p[i - 1, j - 1] - p[i - 1, j + 1] - p[i + 1, j - 1]) / 4
        values, vectors = eigh(-weights[k] * dt**2 * np.array([[xx, xy], [xy, yy]]))
        stiffness = (vectors * np.maximum(values, 0)) @ vectors.T  # positive semidefinite part
        curvature += np.kron(np.outer(basis[k], basis[k]), stiffness)
    return gradient, curvature


def fast_pull(events, ref, position, potentials, scale, stride, factor=1.0):
    cells = Cells.empty(LATTICE.columns, LATTICE.rows)
    for part in cells:
        part[:] = 7  # of the last call
    drawn = (events, ref, position, potentials, scale)
    derivatives.pull(*drawn, factor, cells.gradient)
    derivatives.stiffen(*drawn, stride, factor, cells.curvature)
    vector = np.zeros(LATTICE.unknowns)
    band = np.zeros((LATTICE.unknowns, LATTICE.bandwidth + 1))
    add_cells(*cells, vector, band)
    return vector, dense(band)


def smooth_image(rng, shape):
    images = rng.normal(size=(1, *shape)).astype(np.float32)
    smooth(images, outwards(gaussian(1.0)))
    return images[0]


def test_material_derivative_is_that_of_numpy_gradients(rng):
    flow = rng.normal(size=(5, 4, 3, 2)).astype(np.float32)
    mean = flow.mean(axis=2)
    along = [np.gradient(mean, axis=d) * LATTICE.per_px[d] for d in range(2)]
    expected = flow[:, :, -1] - flow[:, :, 0] + sum(mean[..., d : d + 1] * along[d] for d in (0, 1))
    found = np.empty((5, 4, 2), np.float32)
    material_derivative(flow, LATTICE.per_px, found)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("scale", [0.5, 1.0])
def test_pull_and_gathering_are_the_dense_sums_over_events(rng, scale):
    events = random_events(rng, parts=3)
    position = rng.uniform(-15, 135, (2, EVENTS)).astype(np.float32)
    shape = (int(114 * scale) + 1, int(144 * scale) + 1)
    potentials = np.stack([smooth_image(rng, shape) for _ in range(3)])
    expected_vector, expected = slow_pull(events, 0.5, position, potentials, scale)
    vector, matrix = fast_pull(events, 0.5, position, potentials, scale, 1)
    # Sums of some hundred float32 terms of either sign.
    np.testing.assert_allclose(vector, expected_vector, atol=1e-5 * np.abs(expected_vector).max())
    np.testing.assert_allclose(matrix, expected, atol=1e-5 * expected.max())
    assert np.linalg.eigvalsh(matrix).min() > -1e-5 * expected.max()


def test_factor_and_stride_of_the_curvature(rng):
    """Each stride-th event of a cell counts for all: exact for events that come stride times."""
    events = random_events(rng, parts=1, repeat=2)
    position = np.repeat(rng.uniform(0, 90, (2, EVENTS // 2)).astype(np.float32), 2, axis=1)
    potentials = smooth_image(rng, (115, 145))[None]
    vector, matrix = fast_pull(events, 0.5, position, potentials, 1.0, 1)
    same, sparse = fast_pull(events, 0.5, position, potentials, 1.0, 2, factor=3.0)
    np.testing.assert_allclose(same, 3 * vector, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(sparse, 3 * matrix, atol=1e-5 * matrix.max())


def test_stencil_and_differences_in_time_are_d_transposed_w_d(rng):
    nodes, times = LATTICE.columns * LATTICE.rows, LATTICE.times
    flow = rng.normal(size=(nodes, times, 2))
    weight, limit, in_time = 0.7, 0.4, 1.3
    band = np.zeros((LATTICE.unknowns, LATTICE.bandwidth + 1))
    vector = np.zeros(LATTICE.unknowns)
    matrix, pull = np.zeros((LATTICE.unknowns,) * 2), np.zeros(LATTICE.unknowns)
    per_value = np.eye(2 * times)
    for members, coefficients in LATTICE.second_differences:
        normal_equations.add_stencil(flow, members, coefficients, weight, limit, vector, band)
        for row in members:
            combination = np.zeros((1, nodes))
            combination[0, row] = coefficients
            d = np.kron(combination, per_value)
            z = d @ flow.ravel()
            stiffness = weight / np.sqrt(1 + z @ z / (times * limit**2))
            matrix += stiffness * d.T @ d
            pull -= stiffness * d.T @ z
    normal_equations.add_differences_in_time(flow, in_time, vector, band)
    d = np.kron(np.eye(nodes), np.kron(np.diff(np.eye(times), axis=0), np.eye(2)))
    matrix += in_time * d.T @ d
    pull -= in_time * d.T @ d @ flow.ravel()
    np.testing.assert_allclose(dense(band), matrix, atol=1e-12)
    np.testing.assert_allclose(vector, pull, atol=1e-12)


def test_the_stencils_pull_is_the_gradient_of_charbonnier(rng):
    nodes, coefficients = np.array([[0, 1, 2], [5, 6, 7]]), np.array([1.0, -2.0, 1.0])
    weight, limit = 0.7, 0.4

    def penalty(flow):
        z = np.einsum("k,mkqd->mqd", coefficients, flow[nodes])
        mean_square = (z**2).sum((1, 2)) / flow.shape[1]
        return (weight * flow.shape[1] * limit**2 * np.sqrt(1 + mean_square / limit**2)).sum()

    flow = rng.normal(size=(10, 3, 2))
    vector, band = np.zeros(60), np.zeros((60, 25))
    normal_equations.add_stencil(flow, nodes, coefficients, weight, limit, vector, band)
    for n in range(60):
        step = 1e-5 * (np.arange(60) == n).reshape(flow.shape)
        slope = (penalty(flow + step) - penalty(flow - step)) / 2e-5
        assert vector[n] == pytest.approx(-slope, abs=1e-8)
