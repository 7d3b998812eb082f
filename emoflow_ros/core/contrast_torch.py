"""The contrast on a device of torch: what `contrast.Contrast` computes, for CUDA.

A step is one CUDA graph: the field goes to the device, the cells' gradients and curvatures come
back, and the host waits once, for these.
"""

from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import conv2d

from emoflow_ros.core.cells import PAIR, PAIRS_OF_NODES, Cells
from emoflow_ros.core.contrast import SAMPLING, TAPS
from emoflow_ros.core.device_events import DeviceEvents, host_buffer
from emoflow_ros.core.kernels import MARGIN
from emoflow_ros.core.lattice import Lattice
from emoflow_ros.core.window_events import PAIRS, PARTS, WindowEvents

_WARM_UPS = 3  # before the capture, as torch asks for

F32 = NDArray[np.float32]


class TorchContrast:
    """The contrast at one scale, and its buffers on a device (an ImageContrast).

    On CUDA the order in which events are added to the image, and with it the last bits of all
    that follows, differs from run to run.

    Args:
        lattice: the flow field's lattice.
        scale: resolution; at 1 an image has SAMPLING pixels per pixel of the working image.
        device: of torch.
        capacity: the most events that a window holds.
    """

    def __init__(self, lattice: Lattice, scale: float, *, device: str, capacity: int) -> None:
        # TF32 has too few digits. The switch is the process's, so two threads must not turn it.
        torch.backends.cudnn.allow_tf32 = False
        self.lattice = lattice
        self.scale = scale
        self._again = partial(TorchContrast, lattice, scale, device=device, capacity=capacity)
        self._zoom = SAMPLING * scale  # pixels per pixel of the working image
        self._area = self._zoom**2
        self._shift = MARGIN + 0.5 * self._zoom - 0.5
        height = int(lattice.height * self._zoom) + 2 * MARGIN + 1
        width = int(lattice.width * self._zoom) + 2 * MARGIN + 1
        self._shape = (height, width)
        self._taps = torch.tensor(TAPS, device=device)
        self._taps_twice = torch.tensor(np.convolve(TAPS, TAPS), device=device)
        self._inner = torch.tensor([width - 2, height - 2], device=device)
        self._corners = torch.tensor([0, 1, width, width + 1], device=device)[:, None]
        offsets = [i * width + j for i in (-1, 0, 1) for j in (-1, 0, 1)]
        self._around = torch.tensor(offsets, device=device)[:, None]
        self._image = torch.zeros(height * width, device=device)
        self._parts = torch.zeros(PARTS * height * width, device=device)
        self._events = DeviceEvents(lattice, capacity, device)
        self._field = torch.zeros(lattice.unknowns // 2, 4, device=device)
        self._field_on_host = host_buffer(tuple(self._field.shape), device)
        self._cells = (lattice.columns - 1, lattice.rows - 1)
        self._of_gradient = int(np.prod(self._cells)) * 2 * 8
        of_curvature = int(np.prod(self._cells)) * PAIRS_OF_NODES * 3
        # Of the 8 x 3 x 8 sums of two nodes, those with the first of each product's pairs
        first = np.stack(np.unravel_index(np.unique(PAIR, return_index=True)[1], PAIR.shape))
        products = first[0][:, None] * 24 + np.arange(3) * 8 + first[1][:, None]
        self._products = torch.tensor(products.ravel(), device=device)
        self._answer = torch.zeros(self._of_gradient + of_curvature, device=device)
        self._answer_on_host = host_buffer(tuple(self._answer.shape), device)
        self._run = self._step if device == "cpu" else self._capture().replay

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave the buffers out: they hold nothing from one call to the next."""
        return self._again, ()

    def scores(self, events: WindowEvents, flows: F32) -> F32:
        """Contrasts (n,) of events warped to the middle by constant flows (n, 2), px per window."""
        self._events.load(events)
        x, y, s, weights = self._events.columns
        contrasts = []
        for u, v in flows.tolist():
            position = torch.stack([x + (0.5 - s) * u, y + (0.5 - s) * v], dim=1)
            contrasts.append(self._energy(self._draw(position, weights)))
        return np.array(torch.stack(contrasts).tolist(), np.float32)

    def sharpen(self, events: WindowEvents, flow: F32) -> float:
        """Contrast of events warped to the middle by a flow (columns, rows, times, 2)."""
        self._load(events, flow)
        return self._energy(self._draw(self._warp(), self._events.weights)).item()

    def linearise(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> Cells:
        """Gradient and curvature of the contrast between the window's parts."""
        self._load(events, flow, ref)
        self._run()
        self._answer_on_host.copy_(self._answer)  # waits
        answer = self._answer_on_host.numpy()
        gradient = answer[: self._of_gradient].reshape(*self._cells, 2, 8)
        curvature = answer[self._of_gradient :].reshape(*self._cells, PAIRS_OF_NODES, 3)
        slope = np.float32(self._area * PAIRS)
        return Cells(slope * gradient, slope * np.float32(PAIRS) * curvature)

    def _load(self, events: WindowEvents, flow: F32, ref: float = 0.5) -> None:
        """Send the window's events, where they are new, and the field with its acceleration."""
        self._events.load(events, ref)
        field = self._field_on_host.numpy().reshape(*self.lattice.shape[:3], 4)
        field[..., :2] = flow
        field[..., 2:] = self.lattice.acceleration(flow)[:, :, None]
        self._field.copy_(self._field_on_host, non_blocking=True)

    def _capture(self) -> torch.cuda.CUDAGraph:
        """Record a step, so that it is launched as one."""
        aside = torch.cuda.Stream()
        aside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(aside):
            for _ in range(_WARM_UPS):
                self._step()
        torch.cuda.current_stream().wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self._step()
        return graph

    def _step(self) -> None:
        """Compute contrast, gradient and curvature of the loaded events at the loaded field."""
        events = self._events
        position = self._warp()
        at, inside = self._on_image(position)
        weights = events.weights * inside
        first = events.part * self._image.numel()
        parts = self._vote(self._parts, at, weights, first).view(PARTS, *self._shape)
        parts = self._smooth(parts, self._taps_twice)
        others = (parts.sum(dim=0) - parts).ravel()
        lever = weights * events.lever[:, 0] * self._zoom
        pull = lever * self._slope(others, at, first)
        lever = lever * events.lever[:, 0] * self._zoom * events.copies
        stiffness = _semidefinite(*(lever * self._bend(others, at, first)))
        by_node = (stiffness[..., None] * events.basis).transpose(0, 1).flatten(1)  # (S, 24)
        cells, blocks = events.members.shape
        rows = torch.cat([pull.T, by_node], dim=1).view(blocks, -1, 26)
        sums = events.basis.view(blocks, -1, 8).transpose(1, 2) @ rows
        sums = (events.members @ sums.flatten(1)).view(cells, 8, 26)
        gradient, curvature = sums[..., :2].transpose(1, 2), sums[..., 2:].flatten(1)
        curvature = curvature[:, self._products]
        torch.cat([gradient.flatten(), curvature.flatten()], out=self._answer)

    def _warp(self) -> Tensor:
        """Warp the events to the middle along the field, (S, 2) px, as `kernels.warp`."""
        events = self._events
        near = (events.hats[..., None] * self._field[events.nodes]).sum(dim=1)
        return events.xy + events.lever * (near[:, :2] + 0.5 * events.lever * near[:, 2:])

    def _on_image(self, position: Tensor) -> tuple[Tensor, Tensor]:
        """Map sensor to image positions (N, 2), and tell which are inside, (N,)."""
        at = position * self._zoom + self._shift
        inside = ((at >= 1) & (at < self._inner)).all(dim=1)
        return at.masked_fill(~inside[:, None], 1.0), inside

    def _draw(self, position: Tensor, weights: Tensor) -> Tensor:
        """Draw the smoothed image of events at positions (N, 2) px."""
        at, inside = self._on_image(position)
        image = self._vote(self._image, at, weights * inside, 0)
        return self._smooth(image.view(1, *self._shape), self._taps)

    def _vote(self, images: Tensor, at: Tensor, weights: Tensor, first: Tensor | int) -> Tensor:
        """Add weighted events at positions (N, 2) of images that begin at `first`, (N,) or one."""
        index, (fx, fy) = self._pixel(at)
        shares = torch.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx])
        places = (first + index + self._corners).ravel()
        return images.zero_().index_add_(0, places, (shares * weights).ravel())

    def _pixel(self, at: Tensor) -> tuple[Tensor, Tensor]:
        """Split image positions (N, 2) into the pixel's index (N,) and fractions (2, N)."""
        whole = at.long()
        return whole[:, 1] * self._shape[1] + whole[:, 0], (at - whole).T

    def _smooth(self, images: Tensor, taps: Tensor) -> Tensor:
        """Convolve images (n, h, w) with a kernel along rows and columns, zero outside."""
        radius = len(taps) // 2
        down = conv2d(images[:, None], taps[None, None, :, None], padding=(radius, 0))
        return conv2d(down, taps[None, None, None], padding=(0, radius))[:, 0]

    def _slope(self, images: Tensor, at: Tensor, first: Tensor) -> Tensor:
        """Gradients (2, N) of the images' bilinear interpolants at positions."""
        index, (fx, fy) = self._pixel(at)
        p00, p01, p10, p11 = images[first + index + self._corners]
        return torch.stack(
            [
                (1 - fy) * (p01 - p00) + fy * (p11 - p10),
                (1 - fx) * (p10 - p00) + fx * (p11 - p01),
            ]
        )

    def _bend(self, images: Tensor, at: Tensor, first: Tensor) -> Tensor:
        """Negative second differences (3, N) around the nearest pixel: xx, xy, yy."""
        index, _ = self._pixel(at + 0.5)
        p = images[first + index + self._around]  # (9, N), row by row
        xy = 0.25 * (p[2] + p[6] - p[0] - p[8])
        return torch.stack([2 * p[4] - p[3] - p[5], xy, 2 * p[4] - p[1] - p[7]])

    def _energy(self, image: Tensor) -> Tensor:
        return 0.5 * self._area * image.square().sum()


def _semidefinite(xx: Tensor, xy: Tensor, yy: Tensor) -> Tensor:
    """Cut symmetric matrices to their positive semidefinite part, (3, N)."""
    mean, skew = 0.5 * (xx + yy), 0.5 * (xx - yy)
    root = torch.hypot(skew, xy)
    keep = 0.5 * (mean + root).clamp(min=0) / root.clamp(min=1e-20)
    cut = keep * torch.stack([root + skew, xy, root - skew])
    return torch.where(mean < root, cut, torch.stack([xx, xy, yy]))
