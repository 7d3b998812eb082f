import cv2
import numpy as np
import pytest

from emoflow_ros.core.geometry.camera import Camera, _keeps_its_side
from emoflow_ros.errors import InputError

SIZE = (346, 260)
FOCAL = (226.38, 226.15)
CENTRE = (173.65, 133.73)
LENSES = {
    "none": (),
    "plumb_bob": (-0.368, 0.150, -3e-4, -2.6e-4, 0.01),
    "rational_polynomial": (0.52, -2.7, 8e-4, -5e-4, 1.58, 0.4, -2.5, 1.5),
    "equidistant": (-0.048, 0.0113, -0.0554, 0.0215),
}


def make(lens: str) -> Camera:
    return Camera(*SIZE, *FOCAL, *CENTRE, lens, LENSES[lens])


def opencv_undistorted(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    k, d = camera.intrinsic_matrix, np.array(camera.distortion)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    if camera.model == "equidistant":
        out = cv2.fisheye.undistortPoints(pixels.reshape(-1, 1, 2), k, d, criteria=criteria)
    else:
        out = cv2.undistortPointsIter(
            pixels.reshape(-1, 1, 2), k, d, np.eye(3), np.eye(3), criteria
        )
    return out.reshape(-1, 2)


def pixel_grid(camera: Camera) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([columns, rows], -1).astype(np.float64)


@pytest.mark.parametrize("lens", LENSES)
def test_bearings_are_opencvs(lens):
    camera = make(lens)
    expected = opencv_undistorted(camera, pixel_grid(camera).reshape(-1, 2))
    bearings = camera.bearings
    assert bearings.shape == (260, 346, 2)
    np.testing.assert_allclose(bearings.reshape(-1, 2), expected, atol=2e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_projection_is_opencvs(lens):
    camera = make(lens)
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.8, 0.8, (500, 2)), np.ones(500)])
    points *= rng.uniform(0.5, 20, (500, 1))
    k, d, zero = camera.intrinsic_matrix, np.array(camera.distortion), np.zeros(3)
    if lens == "equidistant":
        expected, _ = cv2.fisheye.projectPoints(points[:, None], zero, zero, k, d)
    else:
        expected, _ = cv2.projectPoints(points, zero, zero, k, d)
    np.testing.assert_allclose(camera.project(points), expected.reshape(-1, 2), atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_undistorting_a_projection_gives_the_bearing_back(lens):
    camera = make(lens)
    bearings = np.random.default_rng(2).uniform(-0.7, 0.7, (40, 50, 2))
    pixels = camera.project(np.concatenate([bearings, np.ones((40, 50, 1))], -1))
    back, _ = camera.undistort(pixels)
    np.testing.assert_allclose(back, bearings, atol=1e-8)


@pytest.mark.parametrize("lens", LENSES)
def test_flow_jacobian_is_the_derivative_of_the_bearing(lens):
    camera = make(lens)
    pixels = np.random.default_rng(3).uniform((0, 0), (345, 259), (300, 2))
    _, jacobian = camera.undistort(pixels)
    step = 1e-3
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ahead, behind = camera.undistort(pixels + shift)[0], camera.undistort(pixels - shift)[0]
        np.testing.assert_allclose(
            jacobian[..., axis], (ahead - behind) / (2 * step), rtol=1e-4, atol=1e-8
        )


@pytest.mark.parametrize("lens", LENSES)
def test_flow_jacobian_is_the_derivative_of_opencvs_bearings(lens):
    """Central differences of OpenCV's undistortion, over the whole image."""
    camera = make(lens)
    pixels = pixel_grid(camera)[::7, ::7].reshape(-1, 2)
    step = 1e-2
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        ahead, behind = (opencv_undistorted(camera, pixels + s) for s in (shift, -shift))
        expected = (ahead - behind) / (2 * step)
        found = camera.flow_jacobian[::7, ::7, :, axis].reshape(-1, 2)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("lens", LENSES)
def test_derivative_of_the_lens_is_opencvs(lens):
    """cv2.projectPoints differentiates by a shift of the points, at a depth of 1."""
    camera = make(lens)
    points = np.random.default_rng(4).uniform(-0.7, 0.7, (200, 2))
    rays = np.column_stack([points, np.ones(200)])
    k, d, zero = camera.intrinsic_matrix, np.array(camera.distortion), np.zeros(3)
    if lens == "equidistant":
        _, jacobian = cv2.fisheye.projectPoints(rays[:, None], zero, zero, k, d)
        by_shift = jacobian[:, 11:13]  # focal lengths, centre, coefficients and turn before it
    else:
        _, jacobian = cv2.projectPoints(rays, zero, zero, k, d)
        by_shift = jacobian[:, 3:5]  # the turn before it
    _, lens_jacobian = camera.distort(points)
    found = lens_jacobian * np.array([[camera.fx], [camera.fy]])
    np.testing.assert_allclose(found.reshape(-1, 2), by_shift, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_flow_jacobian_of_all_pixels(lens):
    camera = make(lens)
    _, jacobian = camera.undistort(pixel_grid(camera))
    np.testing.assert_allclose(camera.flow_jacobian, jacobian, rtol=1e-5, atol=1e-9)
    middle = camera.flow_jacobian[134, 174]
    np.testing.assert_allclose(middle, np.diag(1 / np.array(FOCAL)), rtol=2e-3, atol=1e-5)


@pytest.mark.parametrize("lens", LENSES)
def test_derivative_of_the_lens_at_its_centre_is_one(lens):
    distorted, jacobian = make(lens).distort(np.zeros((1, 2)))
    np.testing.assert_allclose(distorted, 0)
    np.testing.assert_allclose(jacobian[0], np.eye(2), atol=1e-9)


def test_equidistant_sees_half_a_sphere_and_no_more():
    """Without coefficients a ray at angle theta falls on radius f theta, theta < pi / 2."""
    camera = Camera(400, 400, 100.0, 100.0, 200.0, 200.0, "equidistant", (0.0,) * 4)
    theta = 1.2
    inside = np.array([[200 + 100 * theta, 200.0], [200.0, 200 - 100 * theta]])
    bearings, _ = camera.undistort(inside)
    np.testing.assert_allclose(bearings, [[np.tan(1.2), 0], [0, -np.tan(1.2)]], atol=1e-8)
    outside = np.array([[200 + 100 * 1.6, 200.0]])
    bearings, jacobian = camera.undistort(outside)
    assert np.isnan(bearings).all() and np.isnan(jacobian).all()


def test_pixels_without_inverse_do_not_spoil_the_others():
    """With k1 = -0.5 alone r (1 - r^2 / 2) has its maximum 0.544 at r = 0.816."""
    camera = Camera(70, 3, 100.0, 100.0, 0.0, 1.0, "plumb_bob", (-0.5, 0.0, 0.0, 0.0))
    bearings = camera.bearings[1, :, 0]
    assert np.isnan(bearings[57:60]).all()
    valid = bearings[:54].astype(np.float64)
    np.testing.assert_allclose(valid * (1 - 0.5 * valid**2), np.arange(54) / 100, atol=1e-6)
    assert valid.max() < 0.817


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 0}, "size 0x260"),
        ({"height": -1}, "size 346x-1"),
        ({"fx": 0.0}, "focal lengths"),
        ({"fy": -226.0}, "focal lengths"),
        ({"fx": np.nan}, "focal lengths"),
        ({"cx": np.inf}, "not finite"),
        ({"model": "plumb_bob", "distortion": (np.nan, 0.0, 0.0, 0.0)}, "not finite"),
        ({"model": "kannala"}, "unknown distortion model 'kannala'.*equidistant"),
        ({"model": "equidistant", "distortion": (0.1,)}, "with 1 coefficients; give 4"),
        ({"model": "plumb_bob", "distortion": (0.1,) * 3}, "with 3 coefficients; give 0 or 4 or 5"),
        ({"distortion": (0.1,)}, "none with 1 coefficients"),
    ],
)
def test_what_a_camera_refuses(changes, message):
    values = {"width": 346, "height": 260, "fx": 226.0, "fy": 226.0, "cx": 173.0, "cy": 133.0}
    with pytest.raises(InputError, match=f"camera: .*{message}"):
        Camera(**(values | changes))


@pytest.mark.parametrize(
    ("model", "d", "expected_model", "expected_d"),
    [
        ("", (), "none", ()),
        ("", (0.0, 0.0, 0.0, 0.0, 0.0), "none", ()),
        ("plumb_bob", (0.0,) * 5, "none", ()),
        ("plumb_bob", (), "none", ()),
        ("plumb_bob", (0.0,) * 8, "none", ()),
        ("plumb_bob", (0.1, 0.2, 0.3, 0.4, 0.5), "plumb_bob", (0.1, 0.2, 0.3, 0.4, 0.5)),
        ("plumb_bob", (0.1,) * 8, "rational_polynomial", (0.1,) * 8),
        ("rational_polynomial", (0.1,) * 8, "rational_polynomial", (0.1,) * 8),
        ("fisheye", (0.1, 0.2, 0.3, 0.4), "equidistant", (0.1, 0.2, 0.3, 0.4)),
    ],
)
def test_camera_from_camera_info(model, d, expected_model, expected_d):
    k = (226.0, 0.0, 173.0, 0.0, 227.0, 133.0, 0.0, 0.0, 1.0)
    camera = Camera.from_intrinsic_matrix(346, 260, k, model, d)
    assert camera == Camera(346, 260, 226.0, 227.0, 173.0, 133.0, expected_model, expected_d)
    np.testing.assert_array_equal(camera.intrinsic_matrix.ravel(), k)


def test_no_bearing_beyond_a_fold():
    camera = Camera(346, 260, 226.0, 226.0, 173.0, 133.0, "plumb_bob", (-0.4, 0.0, 0.0, 0.0))
    radius = np.linalg.norm((pixel_grid(camera) - (173, 133)) / 226, axis=-1)
    assert np.isnan(camera.bearings[radius > 0.609]).all()  # maximum of r (1 - 0.4 r^2)
    assert np.isfinite(camera.bearings[radius < 0.6]).all()


def test_side_of_a_lens_is_that_of_the_determinant_and_the_trace(monkeypatch):
    """Without numpy's determinant, which took most of a new worker's first window."""
    lens = np.random.default_rng(0).normal(size=(500, 2, 2))
    expected = (np.linalg.det(lens) > 0) & (np.trace(lens, axis1=1, axis2=2) > 0)
    monkeypatch.setattr(np.linalg, "det", None)
    assert 50 < expected.sum() < 250
    np.testing.assert_array_equal(_keeps_its_side(lens), expected)
    assert np.isfinite(Camera(32, 24, 20.0, 20.0, 16.0, 12.0).bearings).all()
