"""Depths that earlier windows have shown, carried on along a known way; and those of patches."""

from dataclasses import replace

import numpy as np
import pytest

from emoflow_ros.core.back_end.known_depths import carried_on, known_depths
from emoflow_ros.core.back_end.settings import BackEndSettings
from emoflow_ros.core.back_end.trajectory import AdjustedMotion, along
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.egomotion import NodeEpipolar
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.lattice.known import INFORMATION_EXCESS
from emoflow_ros.core.lattice.preparation import WorkingImage
from emoflow_ros.core.lattice.refinement import ShownFlow
from emoflow_ros.core.types.estimate import Estimate, Quality, Status

SETTINGS = BackEndSettings()
CAMERA = Camera(173, 130, 120.0, 120.0, 86.0, 64.5)
LATTICE = Lattice.with_spacing(*CAMERA.size, 26.0)
EPIPOLAR = NodeEpipolar(CAMERA, LATTICE, 0.7)
T = np.arange(6) * 40_000_000
SHOWN_AT, NOW, SECONDS = 40_000_000, 150_000_000, 0.08
W, V = np.array([0.2, -0.1, 0.3]), np.array([0.5, 0.1, 0.4])
NODES = len(LATTICE.pixels)
RHO = np.random.default_rng(2).uniform(0.4, 2.0, NODES)


def way(angular: np.ndarray = W, linear: np.ndarray = V) -> AdjustedMotion:
    x = along(T, np.tile(angular, (len(T), 1)), np.tile(linear, (len(T), 1)), np.zeros(0))
    return AdjustedMotion(T, x, True, None)


def shown(information: float = 1.0) -> ShownFlow:
    """The flow of a window, so sure in px^-2 per window^2."""
    flow = SECONDS * (EPIPOLAR.b @ W + RHO[:, None] * (EPIPOLAR.a @ V))
    evidence = np.tile(INFORMATION_EXCESS * information * np.eye(2), (NODES, 1, 1))
    return ShownFlow(SHOWN_AT, SECONDS, EPIPOLAR, flow, evidence)


def test_at_the_same_time_depths_are_those_of_the_flow():
    found = carried_on([shown()], way(), SHOWN_AT, CAMERA, SETTINGS)
    assert found.points == pytest.approx(LATTICE.pixels, abs=1e-3)
    assert found.inverse_depth == pytest.approx(RHO, rel=1e-3)


def test_later_they_are_where_the_camera_sees_these_points():
    found = carried_on([shown()], way(), NOW, CAMERA, SETTINGS)
    steps, seconds = 2000, (NOW - SHOWN_AT) * 1e-9
    points = np.c_[EPIPOLAR.bearings, np.ones(NODES)] / RHO[:, None]
    for _ in range(steps):  # in the camera's frame: X' = -w x X - v
        points = points - seconds / steps * (np.cross(W, points) + V)
    places = CAMERA.project(points)
    margin = 0.075 * max(CAMERA.size)
    inside = ((places > -margin) & (places < np.array(CAMERA.size) - 1 + margin)).all(axis=1)
    assert 25 < inside.sum() < NODES
    assert len(found.points) == inside.sum()
    assert found.points == pytest.approx(places[inside], abs=0.3)
    assert found.inverse_depth == pytest.approx(1 / points[inside, 2], rel=0.01)


def test_a_depth_counts_by_how_well_the_flow_shows_it():
    """Half where its standard deviation is that of the settings, and nothing without evidence."""
    squared = (SECONDS**2 * ((EPIPOLAR.a @ V) ** 2).sum(axis=1)).mean()
    half = 1 / (squared * SETTINGS.node_depth_sd**2)
    weights = [
        carried_on([shown(share * half)], way(), SHOWN_AT, CAMERA, SETTINGS).weight.mean()
        for share in (0.0, 1e-2, 1.0, 1e3)
    ]
    assert weights == pytest.approx([0.0, 0.01, 0.5, 1.0], abs=0.06)
    assert weights[0] == 0


def test_what_moves_by_itself_does_not_count():
    line, static = EPIPOLAR.a @ V, np.arange(NODES) % 2
    across = np.stack([-line[:, 1], line[:, 0]], axis=1)
    across *= 3.0 / np.linalg.norm(across, axis=1, keepdims=True)  # px per window
    moving = shown(1e6)._replace(flow=shown().flow + np.where(static, 0, 1)[:, None] * across)
    found = carried_on([moving], way(), SHOWN_AT, CAMERA, SETTINGS)
    assert found.weight == pytest.approx(static, abs=0.01)


def test_what_the_camera_has_passed_is_left_out():
    ahead = np.array([0.0, 0.0, 40.0])  # by NOW beyond all of them
    flow = SECONDS * (EPIPOLAR.b @ W + RHO[:, None] * (EPIPOLAR.a @ ahead))
    found = carried_on([shown()._replace(flow=flow)], way(linear=ahead), NOW, CAMERA, SETTINGS)
    assert len(found.points) == 0


def test_flow_against_the_translation_shows_no_depth():
    against = shown()._replace(flow=SECONDS * (EPIPOLAR.b @ W - RHO[:, None] * (EPIPOLAR.a @ V)))
    assert len(carried_on([against], way(), NOW, CAMERA, SETTINGS).points) == 0


def patches(information: float) -> Patches:
    """Two patches; the newest node shows only the first."""
    count, slices = 2, len(T)
    found = np.ones((count, slices), np.bool_)
    found[1, -1] = False
    room = Patches.none()
    return replace(
        room,
        born=np.zeros(count, np.int64),
        place=np.array([[50.0, 60.0], [90.0, 20.0]]),
        seen=np.zeros((count, slices, 2)),
        found=found,
        inverse_depth=np.array([1.5, 0.7]),
        of_depth=np.full(count, information),
    )


def estimate() -> Estimate:
    window = 100_000_000, 200_000_000, NOW
    return Estimate(*window, Status.OK, Quality(1, 1, "", 2.0))


@pytest.mark.parametrize(("of_sd", "weight"), [(1.0, 0.5), (10.0, 0.99), (0.1, 0.01)])
def test_patches_count_by_how_well_their_places_show_the_depth(of_sd, weight):
    still = way(np.zeros(3), np.zeros(3))
    information = (of_sd / SETTINGS.patch_depth_sd) ** 2
    image = WorkingImage.of(CAMERA)
    known = known_depths(patches(information), still.x, (), still, estimate(), image, SETTINGS)
    assert known.points == pytest.approx(np.array([[50.0, 60.0]]))  # that the newest node shows
    assert known.inverse_depth == pytest.approx([1.5])
    assert known.weight == pytest.approx([weight], abs=0.005)


def test_a_patch_comes_nearer_and_its_depth_more_uncertain():
    toward = way(np.zeros(3), np.array([0.0, 0.0, 2.0]))
    image, information = WorkingImage.of(CAMERA), 1 / SETTINGS.patch_depth_sd**2
    known = known_depths(patches(information), toward.x, (), toward, estimate(), image, SETTINGS)
    now = 1 / (1 / 1.5 - 2.0 * 0.2)
    assert known.inverse_depth == pytest.approx([now])
    certain = (1.5 / now) ** 4
    assert known.weight == pytest.approx([certain / (1 + certain)])


def test_of_a_large_sensor_points_are_in_its_own_pixels():
    camera = Camera(1280, 720, 900.0, 900.0, 640.0, 360.0)
    image = WorkingImage.of(camera)
    lattice = Lattice.with_spacing(*image.camera.size, 26.0)
    epipolar = NodeEpipolar(image.camera, lattice, 0.7)
    nodes, rho = len(lattice.pixels), 0.8
    flow = SECONDS * (epipolar.b @ W + rho * (epipolar.a @ V))
    evidence = np.tile(1e6 * np.eye(2), (nodes, 1, 1))
    window = ShownFlow(SHOWN_AT, SECONDS, epipolar, flow, evidence)
    found = carried_on([window], way(), SHOWN_AT, camera, SETTINGS)
    assert found.points == pytest.approx(lattice.pixels * image.sensor_px, abs=0.5)
    assert found.inverse_depth == pytest.approx(np.full(nodes, rho), rel=1e-3)
    moves = Lattice(1280, 720, 3, 3)
    to_the_right = np.zeros(moves.shape, np.float32)
    to_the_right[..., 0] = 50.0  # px in 0.1 s
    shows = replace(estimate(), flow=LatticeFlow(moves, to_the_right, 100_000_000, 200_000_000))
    still = way(np.zeros(3), np.zeros(3))
    known = known_depths(patches(1e9), still.x, (), still, shows, image, SETTINGS)
    back = 50.0 * (T[-1] - NOW) / 1e8
    expected = np.array([50.0, 60.0]) * image.sensor_px - [back, 0.0]
    assert known.points[0] == pytest.approx(expected, abs=0.1)


def test_a_lens_that_folds_brings_nothing_back_into_the_image():
    folding = replace(CAMERA, model="plumb_bob", distortion=(-0.2, 0.0, 0.0, 0.0))
    turning = np.array([0.0, -16.0, 0.0])  # rad/s: 101 degrees until NOW
    epipolar = NodeEpipolar(folding, LATTICE, 0.7)
    flow = SECONDS * (epipolar.b @ turning + RHO[:, None] * (epipolar.a @ V))
    evidence = np.tile(1e6 * np.eye(2), (NODES, 1, 1))
    window = ShownFlow(SHOWN_AT, SECONDS, epipolar, flow, evidence)
    found = carried_on([window], way(turning), NOW, folding, SETTINGS)
    assert len(found.points) == 0


def test_windows_beyond_the_nodes_do_not_count():
    image, old = WorkingImage.of(CAMERA), shown()._replace(t=-1)
    later = shown()._replace(t=int(T[-1]) + 1)
    arguments = patches(1e6), way().x, (old, later)
    assert len(known_depths(*arguments, way(), estimate(), image, SETTINGS).points) == 1


def test_earlier_windows_count_beside_patches_where_the_camera_translates():
    image = WorkingImage.of(CAMERA)
    arguments = patches(1e6), way().x, (shown(), shown())
    known = known_depths(*arguments, way(), estimate(), image, SETTINGS)
    turning = replace(way(), translates=False)
    alone = known_depths(*arguments, turning, estimate(), image, SETTINGS)
    each = len(carried_on([shown()], way(), NOW, CAMERA, SETTINGS).points)
    assert len(alone.points) == 1
    assert len(known.points) == 1 + 2 * each
    nothing = carried_on([], way(), NOW, CAMERA, SETTINGS)
    assert len(nothing.points) == len(nothing.weight) == 0
