"""Procedural textures with the statistics of natural images: edges at every scale."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

SIZE = 1024  # texels along one side of the finest level; textures repeat beyond it
LEVELS = 9
_OVERSAMPLING = 2  # leaves are painted this much finer, then averaged: smooth outlines
_LEAVES = 2500
LOG_CONTRAST = 0.45  # standard deviation of the leaves' log intensity


@dataclass(frozen=True)
class TextureSet:
    """Periodic log-intensity textures with their image pyramids.

    Attributes:
        texels: (number of textures, all texels of all levels) float32, log intensity.
        level_start: (LEVELS,) where each level begins in a row of `texels`; level k is a
            (SIZE >> k) squared image.
    """

    texels: NDArray[np.float32]
    level_start: NDArray[np.int64]


def make_textures(count: int, rng: np.random.Generator) -> TextureSet:
    """Paint `count` textures of dead leaves."""
    return texture_set([paint_leaves(rng) for _ in range(count)])


def texture_set(images: Sequence[NDArray[np.float32]]) -> TextureSet:
    """Build the pyramids of periodic images (SIZE, SIZE): each level a 2x2 mean of the finer."""
    sizes = [(SIZE >> level) ** 2 for level in range(LEVELS)]
    start = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    return TextureSet(np.stack([_pyramid(image) for image in images]), start)


def _pyramid(image: NDArray[np.float32]) -> NDArray[np.float32]:
    levels = [image]
    for _ in range(LEVELS - 1):
        levels.append(_halve(levels[-1]))
    return np.concatenate([level.ravel() for level in levels])


def _halve(image: NDArray[np.float32]) -> NDArray[np.float32]:
    n = len(image) // 2
    return np.asarray(image.reshape(n, 2, n, 2).mean(axis=(1, 3)), np.float32)


def paint_leaves(rng: np.random.Generator) -> NDArray[np.float32]:
    """Paint dead leaves over one another: discs and rectangles with sizes after a power law.

    The model (Lee, Mumford and Huang, IJCV 2001) has the scale-invariant edges and the 1/f^2
    spectrum of photographs.
    """
    n = SIZE * _OVERSAMPLING
    smallest, largest = 14.0 * _OVERSAMPLING, 220.0 * _OVERSAMPLING
    # Inverse of the distribution function of p(r) ~ r^-3 between the two radii.
    uniform = rng.random(_LEAVES)
    radius = (smallest**-2 - uniform * (smallest**-2 - largest**-2)) ** -0.5
    canvas = np.zeros((n, n), np.float32)
    _scatter(
        canvas,
        rng.integers(0, n, (_LEAVES, 2)),
        radius,
        np.exp(rng.uniform(-0.7, 0.7, _LEAVES)),
        rng.uniform(0, np.pi, _LEAVES),
        rng.random(_LEAVES) < 0.5,
        rng.normal(0, LOG_CONTRAST, _LEAVES).astype(np.float32),
    )
    canvas = _halve(canvas)
    return canvas - canvas.mean()


@njit(cache=True)
def _scatter(  # type: ignore[no-untyped-def]
    canvas, centre, radius, stretch, angle, is_disc, value
):
    n = canvas.shape[0]
    for k in range(len(radius)):
        cos, sin = np.cos(angle[k]), np.sin(angle[k])
        # Half axes a, b of the same area for every stretch.
        a, b = radius[k] * np.sqrt(stretch[k]), radius[k] / np.sqrt(stretch[k])
        reach = int(np.sqrt(a * a + b * b)) + 1
        for dy in range(-reach, reach + 1):
            row = (centre[k, 1] + dy) % n
            for dx in range(-reach, reach + 1):
                u, v = (cos * dx + sin * dy) / a, (cos * dy - sin * dx) / b
                inside = u * u + v * v < 1 if is_disc[k] else abs(u) < 1 and abs(v) < 1
                if inside:
                    # A slight shade across each leaf keeps its inside from being blank.
                    canvas[row, (centre[k, 0] + dx) % n] = value[k] * (1 + 0.3 * u)
