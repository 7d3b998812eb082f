"""Every sensor is worked on as a DAVIS346's image."""

import numpy as np
import pytest

from emoflow_ros.core.camera import Camera
from emoflow_ros.core.lattice import Lattice, LatticeFlow
from emoflow_ros.core.preparation import WorkingImage, reduction

HD = Camera(1280, 720, 900.0, 910.0, 630.0, 350.0, "plumb_bob", (-0.3, 0.1, 1e-3, 2e-3))


@pytest.mark.parametrize("size", [(240, 180), (346, 260), (180, 346)])
def test_small_sensors_keep_their_pixels(size):
    camera = Camera(*size, 200.0, 200.0, 100.0, 100.0)
    image = WorkingImage.of(camera)
    assert image.camera is camera and reduction(camera) == 1
    np.testing.assert_array_equal(image.sensor_px, [1, 1])
    lattice = Lattice.with_spacing(*size, 26.0)
    flow = np.zeros(lattice.shape, np.float32)
    same = image.on_sensor(lattice, flow)
    assert same[0] is lattice and same[1] is flow


def test_a_large_sensor_s_corners_and_rays_stay_the_same():
    image = WorkingImage.of(HD)
    assert image.camera.size == (346, 195)
    px = np.array([[0.0, 0.0], [345.0, 194.0], [100.0, 50.0]])
    ours, _ = image.camera.undistort(px)
    theirs, _ = HD.undistort(px * image.sensor_px)
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    np.testing.assert_allclose([345, 194] * image.sensor_px, [1279, 719], rtol=1e-6)


def test_flow_comes_back_in_the_sensor_s_pixels():
    image = WorkingImage.of(HD)
    lattice = Lattice.with_spacing(*image.camera.size, 26.0)
    flow = np.zeros(lattice.shape, np.float32) + np.array([2.0, -1.0], np.float32)
    found = LatticeFlow(*image.on_sensor(lattice, flow), 0, 1000).displacement(0, 1000)
    assert found.shape == (720, 1280, 2)
    np.testing.assert_allclose(found, np.broadcast_to([2, -1] * image.sensor_px, found.shape),
                               rtol=1e-5)  # fmt: skip
