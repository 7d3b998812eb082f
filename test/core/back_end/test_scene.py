"""The remembered scene: what the camera's way makes of patches."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from emoflow_ros.core.back_end.adjustment_kernels import Unknowns
from emoflow_ros.core.back_end.scene import deformations
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
