"""The remembered scene: what the camera's way makes of patches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.scene import at_second, deformations
from emoflow_ros.core.front_end.patches import Patches
from emoflow_ros.core.geometry.camera import Camera

LENS = Camera(160, 120, 120.0, 118.0, 80.0, 60.0, "plumb_bob", (-0.3, 0.1, 0.001, -0.002))
PINHOLE = Camera(160, 120, 120.0, 118.0, 80.0, 60.0)


def way(rotation: Rotation, position: tuple[float, float, float]) -> Unknowns:
    """Two nodes; the newest, turned and moved in the frame of the one before, is the origin."""
    turn = rotation.as_matrix()
    return Unknowns(
        np.stack([turn.T, np.eye(3)]), np.stack([-turn.T @ position, np.zeros(3)]),
        np.zeros((2, 3)), np.zeros((2, 3)), np.zeros(0),
    )  # fmt: skip


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
def test_deformations_are_the_derivatives_of_where_points_go(camera):
    rng = np.random.default_rng(0)
    place = rng.uniform([40, 30], [120, 90], (30, 2))
    depths = rng.uniform(0.3, 2.0, 30)
    rotation, position = Rotation.from_rotvec([0.02, -0.03, 0.2]), np.array([0.03, -0.02, 0.08])
    x = way(rotation, tuple(position))

    def seen(points: np.ndarray) -> np.ndarray:
        bearing, _ = camera.undistort(points)
        before = np.concatenate([bearing, np.ones((30, 1))], axis=1) / depths[:, None]
        return camera.project((before - position) @ rotation.as_matrix())

    numeric = np.stack(
        [(seen(place + 0.5 * e) - seen(place - 0.5 * e)) for e in np.eye(2)], axis=-1
    )
    found = deformations(camera, place, x, depths)
    assert found == pytest.approx(numeric, abs=5e-3)
    assert np.abs(numeric - np.eye(2)).max() > 0.2


def test_the_way_tells_where_patches_are_in_the_second_slice_that_shows_them():
    rng = np.random.default_rng(1)
    bearing, depth = rng.uniform(-0.4, 0.4, (30, 2)), rng.uniform(0.3, 2.0, 30)
    rotation, position = Rotation.from_rotvec([0.02, -0.03, 0.2]), np.array([0.03, -0.02, 0.08])
    before = np.concatenate([bearing, np.ones((30, 1))], axis=1) / depth[:, None]
    x, y, z = ((before - position) @ rotation.as_matrix()).T
    wrong = bearing + 0.1  # where they were found
    patches = replace(
        Patches.none(), born=np.zeros(30, np.int64), found=np.ones((30, 2), np.bool_),
        seen=np.stack([bearing, wrong], axis=1), inverse_depth=depth,
    )  # fmt: skip
    places, depths = at_second(patches, way(rotation, tuple(position)), (0.01, 20.0))
    assert places == pytest.approx(np.stack([x / z, y / z], axis=1))
    assert depths == pytest.approx(1 / z)
    unknown = replace(patches, inverse_depth=np.full(30, np.nan))
    places, depths = at_second(unknown, way(rotation, tuple(position)), (0.01, 20.0))
    assert (places == wrong).all()
    assert np.isnan(depths).all()
    past = way(Rotation.identity(), (0.0, 0.0, 4.0))  # all of them
    assert (at_second(patches, past, (0.01, 20.0))[0] == wrong).all()


def test_patches_that_are_not_seen_keep_their_shape():
    place = np.array([[-1.0, -1.0], [80.0, 60.0]])
    x = way(Rotation.from_rotvec([0.0, 0.0, 0.3]), (0.0, 0.0, 0.9))
    # off the image; behind the camera, mirrored through its centre
    found = deformations(PINHOLE, place, x, np.array([1.0, 2 / 0.9]))
    assert (found == np.eye(2)).all()


@pytest.mark.parametrize("camera", [PINHOLE, LENS])
def test_patches_that_leave_the_image_keep_their_shape(camera):
    place = np.array([[152.0, 60.0], [100.0, 60.0]])
    x = way(Rotation.from_rotvec([0.0, -0.1, 0.0]), (0.0, 0.0, 0.0))
    left, stayed = deformations(camera, place, x, np.ones(2))
    assert (left == np.eye(2)).all()
    assert np.abs(stayed - np.eye(2)).max() > 0.005
