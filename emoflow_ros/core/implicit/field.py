"""The flow field as a coordinate network."""

import math

import torch
from torch import Tensor, nn

from emoflow_ros.core.implicit.config import FieldConfig


class CoordinateMLP(nn.Module):
    """Map time and position to flow by a ReLU network with residual layers.

    The (encoded) input enters again halfway, into layer 5 of 8 (method.md, section 2).

    Args:
        config: the network's size and encoding.
        width, height: sensor size in pixels.
        duration: the window's length in seconds.
        generator: source of the initial weights, on the CPU.
    """

    centre: Tensor
    scale: Tensor
    octaves: Tensor

    def __init__(
        self,
        config: FieldConfig,
        width: int,
        height: int,
        duration: float,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        inputs = 3 * (1 + 2 * config.octaves)
        self.skip = config.layers // 2
        sizes = [inputs] + [config.width] * (config.layers - 1)
        if self.skip:
            sizes[self.skip] += inputs
        self.hidden = nn.ModuleList(_linear(n, config.width, generator) for n in sizes)
        self.output = _linear(config.width, 2, generator)
        half = torch.tensor([duration, width - 1, height - 1]) / 2
        if config.normalised:
            centre, scale, self.output_scale = half, 1 / half, config.output_scale
        else:
            centre, scale, self.output_scale = torch.zeros(3), torch.ones(3), 1.0
        self.register_buffer("centre", centre)
        self.register_buffer("scale", scale)
        self.register_buffer("octaves", math.pi * 2.0 ** torch.arange(config.octaves))

    def forward(self, t: Tensor, x: Tensor) -> Tensor:
        """Evaluate the flow.

        Args:
            t: (N,) seconds since the window's start.
            x: (N, 2) pixels, column and row.

        Returns:
            (N, 2) px/s, u right and v down.
        """
        inputs = self._encode(torch.cat([t[:, None], x], dim=1))
        h = torch.relu(self.hidden[0](inputs))
        for i, layer in enumerate(self.hidden[1:], start=1):
            h = h + torch.relu(layer(torch.cat([h, inputs], dim=1) if i == self.skip else h))
        return self.output(h) * self.output_scale

    def _encode(self, coordinates: Tensor) -> Tensor:
        coordinates = (coordinates - self.centre) * self.scale
        phases = (coordinates[:, :, None] * self.octaves).flatten(1)
        return torch.cat([coordinates, phases.sin(), phases.cos()], dim=1)


def _linear(inputs: int, outputs: int, generator: torch.Generator) -> nn.Linear:
    """Make a layer with PyTorch's usual initial weights, from a generator of our own."""
    layer: nn.Linear = nn.utils.skip_init(nn.Linear, inputs, outputs)
    bound = inputs**-0.5
    for parameter in layer.parameters():
        nn.init.uniform_(parameter, -bound, bound, generator=generator)
    return layer
