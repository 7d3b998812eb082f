import math

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from emoflow_ros.core.geometry import camera_motion
from emoflow_ros.core.geometry.camera import Camera
from emoflow_ros.core.geometry.camera_motion import basis
from emoflow_ros.published import losses
from emoflow_ros.published.field import MotionSpline

Array = NDArray[np.float64]


def random_image(seed: int = 0) -> Array:
    return np.random.default_rng(seed).poisson(1.5, (30, 40)).astype(float)


def test_votes_of_one_point_are_its_bilinear_weights() -> None:
    image = losses.vote(torch.tensor([[2.25, 1.5]]), 4, 5)
    expected = torch.zeros(4, 5)
    expected[1, 2], expected[1, 3] = 0.75 * 0.5, 0.25 * 0.5
    expected[2, 2], expected[2, 3] = 0.75 * 0.5, 0.25 * 0.5
    torch.testing.assert_close(image, expected)


def test_points_beyond_the_border_vote_with_what_lies_inside() -> None:
    points = torch.tensor([[-0.25, 0.0], [4.5, 3.0], [-7.0, 2.0], [2.0, 9.0], [1e30, 0.0]])
    image = losses.vote(points, 4, 5)
    assert image[0, 0] == 0.75
    assert image[3, 4] == 0.5
    assert image.sum() == 1.25


def test_votes_agree_with_a_loop_in_numpy() -> None:
    points = np.random.default_rng(1).uniform(-2, 42, (500, 2))
    expected = np.zeros((30, 40))
    for x, y in points:
        for column in (math.floor(x), math.floor(x) + 1):
            for row in (math.floor(y), math.floor(y) + 1):
                if 0 <= column < 40 and 0 <= row < 30:
                    expected[row, column] += (1 - abs(x - column)) * (1 - abs(y - row))
    image = losses.vote(torch.from_numpy(points), 30, 40)
    np.testing.assert_allclose(image.numpy(), expected, atol=1e-12)


def test_blur_is_the_gaussian_of_sigma_one_cut_to_three_pixels() -> None:
    image = random_image()
    expected = ndimage.gaussian_filter(image, 1.0, radius=1, mode="constant")
    np.testing.assert_allclose(losses.blur(torch.from_numpy(image)).numpy(), expected, atol=1e-12)


def reference_gradient(image: Array) -> float:
    magnitude = abs(ndimage.sobel(image, axis=0)) + abs(ndimage.sobel(image, axis=1))
    return float(magnitude[1:-1, 1:-1].mean())


def test_contrast_agrees_with_scipy() -> None:
    image = random_image()
    gradient, variance = reference_gradient(image), image.var()
    tensor = torch.from_numpy(image)
    assert losses.contrast(tensor, "gradient").item() == pytest.approx(gradient, rel=1e-12)
    assert losses.contrast(tensor, "variance").item() == pytest.approx(variance, rel=1e-12)
    both = losses.contrast(tensor, "both").item()
    assert both == pytest.approx(gradient + variance, rel=1e-12)


def test_contrast_pulls_two_points_together() -> None:
    points = torch.tensor([[10.3, 8.4], [11.2, 8.3]], dtype=torch.float64, requires_grad=True)
    losses.contrast(losses.blur(losses.vote(points, 20, 30)), "variance").backward()
    assert points.grad is not None
    assert points.grad[0, 0] > 0
    assert points.grad[1, 0] < 0


def test_gradient_of_the_contrast_agrees_with_finite_differences() -> None:
    generator = torch.Generator().manual_seed(4)
    points = 2 + 8 * torch.rand(20, 2, generator=generator, dtype=torch.float64)
    points.requires_grad_()

    def sharpness(x: Tensor) -> Tensor:
        return losses.contrast(losses.blur(losses.vote(x, 12, 13)), "both")

    assert torch.autograd.gradcheck(sharpness, points, eps=1e-7, atol=1e-6)


def test_occupied_pixels_are_listed_once_and_only_where_valid() -> None:
    valid = torch.ones(4, 5, dtype=torch.bool)
    valid[3, 4] = False
    points = torch.tensor(
        [[1.4, 2.0], [0.6, 2.4], [3.9, 2.8], [4.0, 0.0], [-0.6, 1.0], [2.0, 3.6], [float("nan"), 0]]
    )
    assert losses.occupied_pixels(points, valid).tolist() == [[4, 0], [1, 2]]


def motion_field(camera: Camera, seed: int) -> tuple[Array, Array, Array, Array, Array]:
    """Pixels (N, 2), their flow in px/s for random depths, its part B w, and v, w."""
    rng = np.random.default_rng(seed)
    v, w = rng.normal(size=3), rng.normal(size=3)
    v /= np.linalg.norm(v)
    pixels = np.stack(
        [rng.integers(0, camera.width, 200), rng.integers(0, camera.height, 200)], axis=-1
    )
    bearings, jacobian = camera.undistort(pixels.astype(float))
    a, b = camera_motion.motion_matrices(bearings)
    depth = rng.uniform(1, 10, (200, 1))
    to_pixels = np.linalg.inv(jacobian)
    rotation = np.einsum("nij,nj->ni", to_pixels, b @ w)
    flow = np.einsum("nij,nj->ni", to_pixels, (a @ v) / depth) + rotation
    return pixels, flow, rotation, v, w


@pytest.mark.parametrize("seed", range(5))
def test_dec_is_zero_for_the_motion_field_through_a_lens(small_camera: Camera, seed: int) -> None:
    pixels, flow, _, v, w = motion_field(small_camera, seed)
    maps = losses.PixelMaps.of(small_camera, "cpu")
    bearings, mapped = maps.normalised(torch.tensor(pixels), torch.tensor(flow).float())
    v_tensor, w_tensor = torch.tensor(v).float(), torch.tensor(w).float()
    residual = losses.dec_residual(bearings, mapped, v_tensor, w_tensor)
    assert residual.abs().max() < 1e-5
    reverse = losses.dec_residual(bearings, mapped, v_tensor, -w_tensor)
    assert reverse.abs().max() > 0.1


def test_dec_residual_agrees_with_its_definition_and_the_numpy_core() -> None:
    rng = np.random.default_rng(6)
    bearings, flow = rng.normal(size=(100, 2)), rng.normal(size=(100, 2))
    v, w = rng.normal(size=3), rng.normal(size=3)
    found = losses.dec_residual(*map(torch.from_numpy, (bearings, flow, v, w))).numpy()
    vx, wx = (np.cross(np.eye(3), a) for a in (v, w))
    s = (vx @ wx + wx @ vx) / 2
    x = np.column_stack([bearings, np.ones(100)])
    u = np.column_stack([flow, np.zeros(100)])
    expected = np.einsum("ni,ij,nj->n", u, vx, x) - np.einsum("ni,ij,nj->n", x, s, x)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_allclose(found, camera_motion.dec_residual(bearings, flow, v, w), atol=1e-12)


def test_minimising_the_dec_recovers_the_motion_of_an_exact_flow(small_camera: Camera) -> None:
    pixels, flow, _, v, w = motion_field(small_camera, 8)
    maps = losses.PixelMaps.of(small_camera, "cpu")
    bearings, mapped = maps.normalised(torch.tensor(pixels), torch.tensor(flow).float())
    motion = MotionSpline(0.2)
    weights = torch.from_numpy(basis(0.5)).float()
    optimizer = torch.optim.Adam(motion.parameters(), lr=0.02)
    for _ in range(600):
        optimizer.zero_grad()
        found_v, found_w = motion(weights)
        residual = losses.dec_residual(bearings, mapped, found_v, found_w)
        losses.dec_loss(residual, "huber", 0.1).backward()
        optimizer.step()
    assert abs(found_v.detach().numpy() @ v) > math.cos(math.radians(1))
    np.testing.assert_allclose(found_w.detach(), w, atol=0.02)


def test_rotation_loss_is_zero_for_a_rotation_only(small_camera: Camera) -> None:
    pixels, flow, rotation, _, w = motion_field(small_camera, 7)
    maps = losses.PixelMaps.of(small_camera, "cpu")
    for pixel_flow, low, high in ((rotation, 0, 1e-9), (flow, 1e-2, 10)):
        bearings, mapped = maps.normalised(torch.tensor(pixels), torch.tensor(pixel_flow).float())
        loss = losses.rotation_loss(bearings, mapped, torch.tensor(w).float()).item()
        assert low <= loss < high


def test_rotation_loss_of_no_rotation_is_the_mean_square_flow() -> None:
    flow = torch.tensor([[3.0, 4.0], [1.0, 0.0]])
    assert losses.rotation_loss(torch.zeros(2, 2), flow, torch.zeros(3)).item() == 13.0


def test_huber_is_quadratic_inside_delta_and_linear_beyond() -> None:
    def huber(residual: float) -> float:
        return losses.dec_loss(torch.tensor([residual]), "huber", 0.1).item()

    assert huber(0.06) == pytest.approx(0.06**2 / 2)
    assert huber(-0.5) == pytest.approx(0.1 * (0.5 - 0.05))
    residuals = torch.tensor([0.06, -0.5])
    squares = losses.dec_loss(residuals, "squares", 0.1).item()
    assert squares == pytest.approx((0.06**2 + 0.5**2) / 4)


def test_smoothness_measures_the_slope_of_a_linear_flow() -> None:
    def field(t: Tensor, x: Tensor) -> Tensor:
        return t[:, None] * torch.stack([2 * x[:, 0] - x[:, 1], x[:, 1]], dim=-1)

    loss = losses.smoothness_loss(field, torch.tensor(0.5), 60, 80, 0.1)
    # Per spacing: down, |u| changes by 1 and |v| by 1 px; across, |u| by 2 and |v| by 0.
    expected = 0.5 * 0.1 * losses.SMOOTHNESS_SPACING * ((1 + 1) / 2 + (2 + 0) / 2)
    assert loss.item() == pytest.approx(expected, rel=1e-5)
