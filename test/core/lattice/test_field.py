import numpy as np
import pytest
from scipy.linalg import expm

from emoflow_ros.core.lattice import kernels
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.lattice.field_kernels import bilinear
from emoflow_ros.core.lattice.window_events import CellEvents

MS = 1_000_000
START = 1_500_000_000_000_000_000
END = START + 80 * MS
LATTICE = Lattice(346, 260, 14, 11, 2)
CENTRE = np.array([170.0, 120.0])


def sample(lattice, flow, points, s):
    """The field (N, 2) at points (N, 2) px and time s."""
    return bilinear(lattice.at_time(flow, s), points, lattice.per_px)


def field(flow_at, lattice=LATTICE):
    """Sample flow_at(points (N, 2), s) -> (N, 2) at the nodes."""
    still = [flow_at(lattice.pixels, s) for s in np.linspace(0, 1, lattice.times)]
    return np.stack(still, 1).reshape(lattice.shape).astype(np.float32)


def linear(gradient, drift=(0.0, 0.0), offset=(0.0, 0.0)):
    """u(s, x) = gradient (x - centre) + s drift + offset, in px per window."""
    return lambda x, s: (x - CENTRE) @ np.transpose(gradient) + s * np.array(drift) + offset


ROTATION = np.array([[0.0, -0.1], [0.1, 0.0]])  # 0.1 rad per window
ZOOM = np.array([[0.08, 0.0], [0.0, 0.08]])
SHEAR = np.array([[0.02, 0.05], [-0.03, -0.04]])


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform((90, 60), (250, 200), (400, 2))


def test_nodes_reach_from_corner_to_corner():
    pixels = LATTICE.pixels.reshape(14, 11, 2)
    np.testing.assert_array_equal(pixels[0, 0], [0, 0])
    np.testing.assert_array_equal(pixels[-1, -1], [345, 259])
    np.testing.assert_allclose(np.diff(pixels[:, 0, 0]), 345 / 13)
    np.testing.assert_allclose(LATTICE.per_px, [13 / 345, 10 / 259], rtol=1e-6)


@pytest.mark.parametrize(
    ("size", "spacing", "nodes"),
    [((346, 260), 26.0, (14, 11)), ((240, 180), 26.0, (10, 8)), ((30, 20), 200.0, (3, 3))],
)
def test_lattice_by_spacing(size, spacing, nodes):
    lattice = Lattice.with_spacing(*size, spacing)
    assert (lattice.columns, lattice.rows) == nodes
    assert lattice.shape == (*nodes, lattice.times, 2)
    assert lattice.unknowns == np.prod(lattice.shape)


@pytest.mark.parametrize("s", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("times", [2, 3])
def test_linear_fields_are_interpolated_exactly(points, s, times):
    lattice = Lattice(346, 260, 14, 11, times)
    flow_at = linear(SHEAR, (3.0, -2.0), (5.0, 1.0))
    sampled = sample(lattice, field(flow_at, lattice), points, s)
    np.testing.assert_allclose(sampled, flow_at(points, s), atol=1e-4)


def test_nodes_keep_their_values():
    flow = np.random.default_rng(2).normal(size=LATTICE.shape).astype(np.float32)
    for q, s in enumerate((0.0, 1.0)):
        sampled = sample(LATTICE, flow, LATTICE.pixels, s)
        np.testing.assert_allclose(sampled, flow[:, :, q].reshape(-1, 2), atol=1e-5)


def test_beyond_the_border_the_field_is_constant():
    flow = np.random.default_rng(3).normal(size=LATTICE.shape).astype(np.float32)
    sampled = sample(LATTICE, flow, np.array([[-50.0, -9.0], [900.0, 259.0]]), 0.0)
    np.testing.assert_allclose(sampled, flow[[0, -1], [0, -1], 0], atol=1e-5)


def test_image_is_the_field_at_all_pixels():
    flow = np.random.default_rng(4).normal(size=LATTICE.shape).astype(np.float32)
    image = LATTICE.image(LATTICE.at_time(flow, 0.4))
    assert image.shape == (260, 346, 2)
    pixels = np.stack(np.meshgrid(np.arange(346.0), np.arange(260.0)), -1).reshape(-1, 2)
    np.testing.assert_allclose(image.reshape(-1, 2), sample(LATTICE, flow, pixels, 0.4), atol=2e-5)


def test_acceleration_is_the_material_derivative():
    """For u = G (x - c) + s d + o it is d + G u; taken in the middle of the window."""
    flow_at = linear(SHEAR, (3.0, -2.0), (5.0, 1.0))
    expected = flow_at(LATTICE.pixels, 0.5) @ SHEAR.T + (3.0, -2.0)
    acceleration = LATTICE.acceleration(field(flow_at))
    np.testing.assert_allclose(acceleration.reshape(-1, 2), expected, atol=1e-4)


@pytest.mark.parametrize("gradient", [ROTATION, ZOOM, SHEAR])
def test_advance_follows_the_closed_form(points, gradient):
    """dx/ds = G (x - c) is solved by the matrix exponential."""
    flow = field(linear(gradient))
    for start, end in ((0.0, 1.0), (1.0, 0.0), (0.2, 0.7)):
        expected = CENTRE + (points - CENTRE) @ expm((end - start) * gradient).T
        moved = LATTICE.advance(flow, points, start, end)
        np.testing.assert_allclose(moved, expected, atol=2e-3)


@pytest.mark.parametrize("gradient", [ROTATION, ZOOM, SHEAR])
def test_advance_there_and_back_is_the_identity(points, gradient):
    flow = field(linear(gradient, (3.0, -2.0), (5.0, 1.0)))
    there = LATTICE.advance(flow, points, 0.0, 1.0)
    assert np.linalg.norm(there - points, axis=1).mean() > 5
    back = LATTICE.advance(flow, there, 1.0, 0.0)
    np.testing.assert_allclose(back, points, atol=2e-3)


def test_advance_stays_on_the_lattice_whatever_the_points():
    """Beyond the border the flow is that of the border; what is not finite becomes NaN."""
    flow = field(linear(np.zeros((2, 2)), offset=(3.0, -2.0)))
    far = [-1.0, 0.0, 345.0, 346.0, 259.0, 1e6, -1e6, 1e30, -1e30, 1e300, -1e300]
    points = np.array([[x, y] for x in far for y in far])
    moved = LATTICE.advance(flow, points, 0.0, 1.0)
    np.testing.assert_allclose(moved, points + np.array([3.0, -2.0]), rtol=1e-6, atol=1e-5)
    bad = [np.nan, np.inf, -np.inf]
    points = np.array([(b, 5.0) for b in bad] + [(5.0, b) for b in bad] + [(b, b) for b in bad])
    assert np.isnan(LATTICE.advance(flow, points, 0.0, 1.0)).all()
    for value in (np.nan, np.inf, 1e30):
        LATTICE.advance(np.full_like(flow, value), np.array([[5.0, 5.0]] * 9), 0.0, 1.0)


def test_advance_is_that_of_points_in_double_precision(points):
    rng = np.random.default_rng(2)
    flow = rng.normal(0, 8, LATTICE.shape).astype(np.float32)
    expected = points
    for k in range(4):
        s = k / 4
        halfway = bilinear(LATTICE.at_time(flow, s), expected, LATTICE.per_px)
        middle = bilinear(LATTICE.at_time(flow, s + 1 / 8), expected + halfway / 8, LATTICE.per_px)
        expected = expected + middle / 4
    np.testing.assert_allclose(LATTICE.advance(flow, points, 0.0, 1.0), expected, atol=2e-4)


def test_advance_is_of_second_order(points):
    """One step against two of half the length: a quarter of the error."""
    strong = 10 * ROTATION  # 0.25 rad in a quarter of the window
    flow = field(linear(strong))
    exact = CENTRE + (points - CENTRE) @ expm(0.25 * strong).T
    one = LATTICE.advance(flow, points, 0.0, 0.25)
    two = LATTICE.advance(flow, LATTICE.advance(flow, points, 0.0, 0.125), 0.125, 0.25)
    errors = [np.linalg.norm(moved - exact, axis=1).mean() for moved in (one, two)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.15)


@pytest.mark.parametrize(("gradient", "drift"), [(ROTATION, (0, 0)), (ZOOM, (0, 0)),
                                                 (SHEAR, (6.0, -4.0))])  # fmt: skip
def test_warp_is_transport_to_second_order(points, gradient, drift):
    """Half the way in time leaves an eighth of the error, as a Taylor step of order 2 does."""
    flow = field(linear(3 * gradient, drift, (4.0, 2.0)))
    acceleration = LATTICE.acceleration(flow)
    columns = np.ascontiguousarray(points.T.astype(np.float32))
    errors = []
    for dt in (0.4, 0.2):
        s = np.full(len(points), 0.5 - dt, np.float32)
        warped = np.empty_like(columns)
        events = CellEvents.of(*columns, s, np.ones_like(s), LATTICE, 1)
        kernels.warp(events, 0.5, flow, acceleration, warped)
        exact, steps = np.stack([events.x, events.y], axis=1).astype(np.float64), 64
        for k in range(steps):
            exact = LATTICE.advance(
                flow, exact, 0.5 - dt + dt * k / steps, 0.5 - dt + dt * (k + 1) / steps
            )
        errors.append(np.linalg.norm(warped.T - exact, axis=1).mean())
    assert errors[0] < 0.6
    assert errors[0] / errors[1] == pytest.approx(8, rel=0.25)


def flow_of(flow_at) -> LatticeFlow:
    return LatticeFlow(LATTICE, field(flow_at), START, END)


def test_constant_flow_in_all_its_forms(points):
    """8 px right and 4 px up in 80 ms."""
    flow = flow_of(linear(np.zeros((2, 2)), offset=(8.0, -4.0)))
    velocity = flow.velocity(START + 20 * MS)
    assert velocity.shape == (260, 346, 2)
    np.testing.assert_allclose(velocity, np.broadcast_to([100, -50], velocity.shape), rtol=1e-5)
    moved = flow.displacement(START + 20 * MS, START + 60 * MS)
    np.testing.assert_allclose(moved, np.broadcast_to([4, -2], moved.shape), rtol=1e-4)
    tracks = flow.tracks(points, [START + 10 * MS, START + 50 * MS, START])
    np.testing.assert_array_equal(tracks[0], points)
    np.testing.assert_allclose(tracks[1], points + np.array([4, -2]), atol=1e-4)
    np.testing.assert_allclose(tracks[2], points + np.array([-1, 0.5]), atol=1e-4)


def test_displacement_of_a_rotation_about_the_axis():
    """Half of the way through 0.1 rad per window, in closed form."""
    flow = flow_of(linear(ROTATION))
    moved = flow.displacement(START + 10 * MS, START + 50 * MS)
    pixels = np.stack(np.meshgrid(np.arange(346.0), np.arange(260.0)), -1)
    expected = (pixels - CENTRE) @ (expm(0.5 * ROTATION) - np.eye(2)).T
    inside = np.s_[40:200, 60:280]  # rays that stay on the lattice
    np.testing.assert_allclose(moved[inside], expected[inside], atol=2e-3)


def test_velocity_is_the_derivative_of_the_displacement():
    flow = flow_of(linear(SHEAR, (3.0, -2.0), (5.0, 1.0)))
    t, step = START + 30 * MS, MS
    slope = (flow.displacement(t, t + step) - flow.displacement(t, t - step)) / 2e-3
    inside = np.s_[2:-2, 2:-2]
    np.testing.assert_allclose(slope[inside], flow.velocity(t)[inside], atol=0.05)


def test_tracks_of_the_pixels_are_their_displacements():
    flow = flow_of(linear(ZOOM, (3.0, -2.0)))
    pixels = np.array([[20.0, 30.0], [300.0, 200.0], [173.0, 5.0]])
    tracks = flow.tracks(pixels, [START, END])
    moved = flow.displacement(START, END)[[30, 200, 5], [20, 300, 173]]
    np.testing.assert_allclose(tracks[1] - tracks[0], moved, atol=1e-4)


def test_outside_the_window_the_velocity_stays():
    flow = flow_of(linear(SHEAR, (3.0, -2.0)))
    np.testing.assert_array_equal(flow.velocity(START - MS), flow.velocity(START))
    np.testing.assert_array_equal(flow.velocity(END + MS), flow.velocity(END))


def test_displacement_over_an_interval_beyond_the_window():
    """Flow 8 s px per window of 80 ms: 0 before it, 4 px in it, 0.1 px/ms after it."""
    flow = flow_of(linear(np.zeros((2, 2)), drift=(8.0, 0.0)))
    for before, after, u in [(-80, 0, 0), (0, 80, 4), (80, 160, 8), (-40, 120, 8), (100, 130, 3)]:
        moved = flow.displacement(START + before * MS, START + after * MS)
        np.testing.assert_allclose(moved[..., 0], u, rtol=1e-4, atol=1e-6)
        np.testing.assert_array_equal(moved[..., 1], 0)


def test_rotation_goes_on_beyond_the_window():
    """0.15 rad in one and a half windows, half of them before it."""
    flow = flow_of(linear(ROTATION))
    points = CENTRE + np.array([[30.0, 0.0], [0.0, -50.0]])
    tracks = flow.tracks(points, [START - 40 * MS, END])
    expected = CENTRE + (points - CENTRE) @ expm(1.5 * ROTATION).T
    np.testing.assert_allclose(tracks[1], expected, atol=2e-3)


def test_an_interval_of_many_windows_takes_bounded_time():
    flow = LatticeFlow(
        LATTICE, field(linear(np.zeros((2, 2)), offset=(1e-6, 0.0))), START, START + 1
    )
    tracks = flow.tracks(CENTRE[None], [START - 100 * MS, START])
    np.testing.assert_allclose(tracks[1] - CENTRE, [[100.0, 0.0]], rtol=1e-4)
