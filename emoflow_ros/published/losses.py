"""Losses of the published method (docs/published_method.md), in PyTorch."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from emoflow_ros.core.geometry.camera import Camera

# A flow of low frequency shows its variation at this distance as well as at 1 px.
SMOOTHNESS_SPACING = 16


@dataclass(frozen=True)
class PixelMaps:
    """A camera's maps as tensors: bearings (H, W, 2), flow Jacobian (H, W, 2, 2), valid (H, W)."""

    bearings: Tensor
    jacobian: Tensor
    valid: Tensor

    @classmethod
    def of(cls, camera: Camera, device: str) -> "PixelMaps":
        """Copy a camera's maps to a device."""
        bearings = torch.tensor(camera.bearings, device=device)
        jacobian = torch.tensor(camera.flow_jacobian, device=device)
        return cls(bearings, jacobian, bearings.isfinite().all(dim=-1))

    def normalised(self, pixels: Tensor, flow: Tensor) -> tuple[Tensor, Tensor]:
        """Map flow (N, 2) in px/s at integer pixels (N, 2) to bearings (N, 2) and flow in 1/s."""
        column, row = pixels.unbind(-1)
        mapped = torch.einsum("nij,nj->ni", self.jacobian[row, column], flow)
        return self.bearings[row, column], mapped


def vote(points: Tensor, height: int, width: int) -> Tensor:
    """Build the image of warped events by bilinear voting.

    Args:
        points: (N, 2) pixels; what lies outside the image does not count.

    Returns:
        (height, width) votes, differentiable in the points. On the CPU the sum is taken in
        the order of the points, so that it is the same bit by bit in every run.
    """
    corner = points.detach().floor()
    fraction = points - corner
    column, row = corner.long().unbind(-1)
    index, weight = [], []
    for right in (0, 1):
        for down in (0, 1):
            x, y = column + right, row + down
            wx = fraction[:, 0] if right else 1 - fraction[:, 0]
            wy = fraction[:, 1] if down else 1 - fraction[:, 1]
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            index.append(y.clamp(0, height - 1) * width + x.clamp(0, width - 1))
            weight.append(wx * wy * inside)
    image = torch.zeros(height * width, dtype=points.dtype, device=points.device)
    return image.index_add(0, torch.cat(index), torch.cat(weight)).view(height, width)


def blur(image: Tensor) -> Tensor:
    """Smooth an image (H, W) by a 3x3 Gaussian of sigma 1 px, zeros beyond its border."""
    offsets = torch.tensor([-1.0, 0.0, 1.0], dtype=image.dtype, device=image.device)
    profile = torch.exp(-(offsets**2) / 2)
    profile = profile / profile.sum()
    return _filter(image, profile[:, None] * profile, padding=1)


def contrast(image: Tensor, kind: str) -> Tensor:
    """Measure the sharpness of an image (H, W).

    Args:
        kind: `gradient` is mean(|Sobel_x| + |Sobel_y|) over the pixels that have all their
            neighbours, `variance` is over all pixels, `both` is the sum.
    """
    total = image.new_zeros(())
    if kind in ("gradient", "both"):
        across = torch.tensor([-1.0, 0.0, 1.0], dtype=image.dtype, device=image.device)
        along = torch.tensor([1.0, 2.0, 1.0], dtype=image.dtype, device=image.device)
        sobel_x = _filter(image, along[:, None] * across)
        sobel_y = _filter(image, across[:, None] * along)
        total = total + (sobel_x.abs() + sobel_y.abs()).mean()
    if kind in ("variance", "both"):
        total = total + image.var(correction=0)
    return total


def _filter(image: Tensor, kernel: Tensor, padding: int = 0) -> Tensor:
    return functional.conv2d(image[None, None], kernel[None, None], padding=padding)[0, 0]


def occupied_pixels(points: Tensor, valid: Tensor) -> Tensor:
    """List the valid pixels (M, 2) nearest to any of the points (N, 2).

    Their number is not known beforehand, so that the host waits for a CUDA device here.

    Args:
        valid: (H, W) mask.
    """
    height, width = valid.shape
    column, row = points.detach().round().long().unbind(-1)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    held = torch.zeros_like(valid)
    held[row[inside], column[inside]] = True
    return (held & valid).nonzero().flip(-1)


def dec_residual(bearings: Tensor, flow: Tensor, v: Tensor, w: Tensor) -> Tensor:
    """Evaluate the differential epipolar constraint as `dec_residual` of core.geometry does.

    Args:
        bearings: (N, 2) on the undistorted normalised plane.
        flow: (N, 2) there, 1/s.
        v, w: (3,) linear and angular velocity.

    Returns:
        (N,) residuals in 1/s for |v| = 1.
    """
    x, y = bearings.unbind(-1)
    remaining = flow - rotational_flow(bearings, w)
    return remaining[:, 1] * (x * v[2] - v[0]) - remaining[:, 0] * (y * v[2] - v[1])


def rotational_flow(bearings: Tensor, w: Tensor) -> Tensor:
    """Evaluate B w, the flow (N, 2) in 1/s of a rotation w (3,) at bearings (N, 2)."""
    x, y = bearings.unbind(-1)
    return torch.stack(
        [
            x * y * w[0] - (1 + x * x) * w[1] + y * w[2],
            (1 + y * y) * w[0] - x * y * w[1] - x * w[2],
        ],
        dim=-1,
    )


def dec_loss(residual: Tensor, penalty: str, delta: float) -> Tensor:
    """Average residuals under a penalty: e^2 / 2 for `squares`, linear beyond delta for `huber`."""
    if penalty == "huber":
        return functional.huber_loss(residual, torch.zeros_like(residual), delta=delta)
    return residual.square().mean() / 2


def rotation_loss(bearings: Tensor, flow: Tensor, w: Tensor) -> Tensor:
    """Average |U - B w|^2, for pure rotation, where every v fulfils the DEC."""
    return (flow - rotational_flow(bearings, w)).square().sum(dim=-1).mean()


def smoothness_loss(field: nn.Module, t: Tensor, height: int, width: int, unit: float) -> Tensor:
    """Measure the flow's total variation between neighbours of a lattice over the image.

    Args:
        t: () instant, s.
        unit: seconds that turn px/s into the displacement whose variation counts.

    Returns:
        Mean absolute difference of the displacement, px per lattice spacing.
    """
    rows = torch.arange(0, height, SMOOTHNESS_SPACING, device=t.device, dtype=t.dtype)
    columns = torch.arange(0, width, SMOOTHNESS_SPACING, device=t.device, dtype=t.dtype)
    pixels = torch.cartesian_prod(rows, columns).flip(-1)
    flow = unit * field(t.expand(len(pixels)), pixels).view(len(rows), len(columns), 2)
    return flow.diff(dim=0).abs().mean() + flow.diff(dim=1).abs().mean()
