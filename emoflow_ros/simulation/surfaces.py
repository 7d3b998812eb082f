"""Flat textured rectangles, and the rooms and boxes that are made of them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

STATIC, MOVING = 0, 1  # more bodies that move by themselves are MOVING + 1, ...


@dataclass(frozen=True)
class Quad:
    """A textured rectangle in the frame of the body that carries it.

    Attributes:
        corner: (3,) m.
        along_u, along_v: (3,) edges from the corner in m, at right angles to each other.
        texture: index into the texture set.
        texel: side of the finest texel in m.
        contrast: factor on the texture's log intensity.
        shade: added to the log intensity.
        body: STATIC, or MOVING plus the number of the body that moves by itself.
    """

    corner: NDArray[np.float64]
    along_u: NDArray[np.float64]
    along_v: NDArray[np.float64]
    texture: int
    texel: float
    contrast: float = 1.0
    shade: float = 0.0
    body: int = STATIC


@dataclass(frozen=True)
class Look:
    """How the faces of a room or box are painted: textures are drawn from the set."""

    textures: int
    texel: float
    contrast: float = 1.0
    body: int = STATIC


def cuboid(
    centre: tuple[float, float, float],
    size: tuple[float, float, float],
    yaw: float,
    look: Look,
    rng: np.random.Generator,
) -> list[Quad]:
    """Six faces of a box turned by `yaw` rad about the vertical (y) axis, or of a room."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    axes = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]]) * np.array(size)[:, None]
    low = np.array(centre) - axes.sum(axis=0) / 2
    quads = []
    for normal in range(3):
        u, v = axes[(normal + 1) % 3], axes[(normal + 2) % 3]
        for corner in (low, low + axes[normal]):
            quads.append(
                Quad(
                    corner,
                    u,
                    v,
                    int(rng.integers(look.textures)),
                    look.texel,
                    look.contrast,
                    float(rng.normal(0, 0.25)),
                    look.body,
                )
            )
    return quads
