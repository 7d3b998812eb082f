"""Every sensor is worked on as a DAVIS346's image."""

import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.lattice.config import LatticeConfig
from emoflow_ros.core.lattice.field import Lattice, LatticeFlow
from emoflow_ros.core.lattice.preparation import WorkingImage, prepare, reduction
from emoflow_ros.core.types.events import Events, Window

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


START, END = 1_500_000_000_000_000_000, 1_500_000_000_050_000_000


def window_of(camera: Camera, t: np.ndarray) -> Window:
    """Events anywhere on the sensor, its last column and row among them."""
    rng = np.random.default_rng(0)
    x, y = (rng.integers(0, side, len(t)).astype(np.uint16) for side in camera.size)
    x[:50], y[:50] = camera.width - 1, camera.height - 1
    return Window(START, END, Events(x, y, t, rng.random(len(t)) < 0.5))


@pytest.mark.parametrize("camera", [HD, Camera(346, 260, 200.0, 200.0, 170.0, 130.0)])
def test_events_are_moved_to_the_working_image_and_to_times_from_0_to_1(camera):
    window = window_of(camera, np.linspace(START, END, 4000).astype(np.int64))
    image, events = WorkingImage.of(camera), window.events
    found = prepare(window, image, LatticeConfig(max_events=2000))
    assert found is not None
    px = image.sensor_px
    np.testing.assert_array_equal(found.x, events.x[::2].astype(np.float32) / px[0])
    np.testing.assert_array_equal(found.y, events.y[::2].astype(np.float32) / px[1])
    np.testing.assert_allclose(found.s, (events.t[::2] - START) / (END - START), rtol=1e-6)
    np.testing.assert_array_equal(found.weights > 0, events.p[::2])
    assert found.x.max() == image.camera.width - 1 and found.y.max() == image.camera.height - 1


@pytest.mark.parametrize("moved", [-1_000, 1_000])
def test_events_outside_the_window_s_interval_are_refused(moved):
    """One at its end may be there: in windows by count some are."""
    t = np.linspace(START, END, 4000).astype(np.int64) + moved
    with pytest.raises(ValueError, match="between t_start and t_end"):
        prepare(window_of(HD, t), WorkingImage.of(HD), LatticeConfig())


@pytest.mark.parametrize(("side", "enough"), [(24, False), (40, True)])
def test_events_on_few_blocks_are_too_little(side, enough):
    """Blocks of 8 px, of which 16 must hold events."""
    window = window_of(HD, np.linspace(START, END, 4000).astype(np.int64))
    px = WorkingImage.of(HD).sensor_px
    small = (window.events.x % (side * px[0])).astype(np.uint16)
    low = (window.events.y % (side * px[1])).astype(np.uint16)
    few = Events(small, low, window.events.t, window.events.p)
    found = prepare(Window(START, END, few), WorkingImage.of(HD), LatticeConfig())
    assert (found is not None) is enough
