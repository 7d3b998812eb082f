"""Procedural textures: dead leaves, prints and blank paint, with their image pyramids."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from emoflow_ros.core.numerics.jit import njit
from emoflow_ros.errors import InputError
from emoflow_ros.simulation.factors import TEXTURE_KINDS, Factors

SIZE = 1024  # texels along one side of the finest level; textures repeat beyond it
LEVELS = 9
_OVERSAMPLING = 2  # leaves are painted this much finer, then averaged: smooth outlines
_LEAF_COUNT = 2500
LOG_CONTRAST = 0.45  # standard deviation of the leaves' log intensity
FEATURE = 14.0  # texels: radius of the smallest leaves, width of stripes, letters' size
PAINTED, BLANK = 5, 5  # number of textures with a pattern; the index of the one without
_SHADING = 0.02  # log contrast of blank paint
_PHOTOS = (
    "astronaut",
    "brick",
    "camera",
    "chelsea",
    "coffee",
    "coins",
    "grass",
    "gravel",
    "rocket",
)
_DARKEST = 10.0  # of 255: added to each pixel, so that the logarithm of black is finite

Texels = NDArray[np.float32]


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
    return _texture_set([_leaves(rng) for _ in range(count)])


def random_textures(factors: Factors) -> TextureSet:
    """Paint the textures of a random recording: PAINTED patterns, then the blank one.

    The first patterns are of the recording's kind, the last two of any kind. Each covers its
    wall only in part, as posters and shelves do; the rest is blank.
    """
    rng = factors.generator("textures")
    # The camera sees nothing but the plane.
    blank = min(factors.blank_share, 0.5) if factors.scene == "plane" else factors.blank_share
    images = []
    for k in range(PAINTED):
        kind = factors.texture if k < PAINTED - 2 else TEXTURE_KINDS[int(rng.integers(6))]
        pattern = _PAINTERS[kind](rng)
        mask = _posters(1 - blank, rng)
        images.append(np.where(mask, pattern, _shading(rng)).astype(np.float32))
    return _texture_set([*images, _shading(rng)])


def _texture_set(images: Sequence[Texels]) -> TextureSet:
    """Build the pyramids of periodic images (SIZE, SIZE): each level a 2x2 mean of the finer."""
    sizes = [(SIZE >> level) ** 2 for level in range(LEVELS)]
    start = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    return TextureSet(np.stack([_pyramid(image) for image in images]), start)


def _pyramid(image: Texels) -> Texels:
    levels = [image]
    for _ in range(LEVELS - 1):
        levels.append(_halve(levels[-1]))
    return np.concatenate([level.ravel() for level in levels])


def _halve(image: Texels) -> Texels:
    n = len(image) // 2
    return np.asarray(image.reshape(n, 2, n, 2).mean(axis=(1, 3)), np.float32)


def _leaves(rng: np.random.Generator) -> Texels:
    """Paint dead leaves over one another: discs and rectangles with sizes after a power law.

    The model (Lee, Mumford and Huang, IJCV 2001) has the scale-invariant edges and the 1/f^2
    spectrum of photographs.
    """
    n = SIZE * _OVERSAMPLING
    smallest, largest = 14.0 * _OVERSAMPLING, 220.0 * _OVERSAMPLING
    # Inverse of the distribution function of p(r) ~ r^-3 between the two radii.
    uniform = rng.random(_LEAF_COUNT)
    radius = (smallest**-2 - uniform * (smallest**-2 - largest**-2)) ** -0.5
    canvas = np.zeros((n, n), np.float32)
    _scatter(
        canvas,
        rng.integers(0, n, (_LEAF_COUNT, 2)),
        radius,
        np.exp(rng.uniform(-0.7, 0.7, _LEAF_COUNT)),
        rng.uniform(0, np.pi, _LEAF_COUNT),
        rng.random(_LEAF_COUNT) < 0.5,
        rng.normal(0, LOG_CONTRAST, _LEAF_COUNT).astype(np.float32),
    )
    canvas = _halve(canvas)
    return canvas - canvas.mean()


@njit()
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


def _blotches(rng: np.random.Generator) -> Texels:
    """Clouds without any sharp edge."""
    image = sum(_smooth_noise(sigma, rng) * sigma for sigma in (1.0 * FEATURE, 3.0 * FEATURE))
    return _normalised(np.asarray(image))


def _noise(rng: np.random.Generator) -> Texels:
    """Grain like that of asphalt, plaster or a carpet."""
    return _normalised(_smooth_noise(0.25 * FEATURE, rng) + 0.5 * _smooth_noise(FEATURE, rng))


def _stripes(rng: np.random.Generator) -> Texels:
    """Parallel bars of one width, along an axis or at a slant."""
    cycles = round(SIZE / (2 * FEATURE * rng.uniform(1.5, 4)))
    across = int(rng.choice((0, 0, 1, 2, -3)))
    phase = _phase(cycles, across) if rng.random() < 0.5 else _phase(across, cycles)
    return _normalised(np.tanh(4 * np.sin(phase)))


def _checker(rng: np.random.Generator) -> Texels:
    cycles = round(SIZE / (2 * FEATURE * rng.uniform(1.5, 4)))
    return _normalised(np.tanh(8 * np.sin(_phase(cycles, 0)) * np.sin(_phase(0, cycles))))


def _text(rng: np.random.Generator) -> Texels:
    """Lines of dark strokes on pale paper: letters of random strokes, words and margins."""
    page = np.zeros((SIZE, SIZE))
    stroke, letter = 4, int(FEATURE)
    for top in range(8, SIZE - 2 * letter, 2 * letter + 4):
        if rng.random() < 0.12:
            continue  # between paragraphs
        end = SIZE - int(rng.choice((20, 60, 400)))
        for left in range(20, end, letter + 4):
            if rng.random() < 0.18:
                continue  # between words
            height = int(1.5 * letter) if rng.random() < 0.3 else letter
            glyph = page[top + int(1.5 * letter) - height : top + int(1.5 * letter), left:]
            glyph = glyph[:, :letter]
            uprights, bars = rng.random(3) < 0.5, rng.random(3) < 0.5
            for k, at in enumerate((0, (letter - stroke) // 2, letter - stroke)):
                glyph[:, at : at + stroke] -= uprights[k]
            for k, at in enumerate((0, (height - stroke) // 2, height - stroke)):
                glyph[at : at + stroke] -= bars[k]
    page = np.maximum(page, -1.0)
    return np.asarray(4 * LOG_CONTRAST * 0.8 * (page - page.mean()), np.float32)


def _photo(rng: np.random.Generator) -> Texels:
    """A part of a photograph that scikit-image ships, mirrored so that it is periodic.

    Raises:
        InputError: scikit-image is not installed.
    """
    name = str(rng.choice(_PHOTOS))
    try:
        data = import_module("skimage.data")
    except ImportError:
        raise InputError(
            "texture photo", "scikit-image is not installed", "run 'pip install scikit-image'"
        ) from None
    image = np.asarray(getattr(data, name)(), np.float64)
    gray = image.mean(axis=-1) if image.ndim == 3 else image
    side = int(min(gray.shape) * rng.uniform(0.5, 1.0))
    top, left = (int(rng.integers(0, n - side + 1)) for n in gray.shape)
    part = ndimage.zoom(gray[top : top + side, left : left + side], SIZE / 2 / side, order=1)
    half = np.concatenate([part, part[:, ::-1]], axis=1)
    return _normalised(np.log(np.concatenate([half, half[::-1]]) + _DARKEST))


_PAINTERS: dict[str, Callable[[np.random.Generator], Texels]] = {
    "leaves": _leaves,
    "blotches": _blotches,
    "noise": _noise,
    "stripes": _stripes,
    "checker": _checker,
    "text": _text,
    "photo": _photo,
}


def _posters(share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Mask (SIZE, SIZE) of random rectangles that cover `share` of a texture."""
    mask = np.zeros((SIZE, SIZE), np.bool_)
    if share >= 0.98:
        return ~mask
    while mask.mean() < share:
        height, width = rng.integers(SIZE // 12, SIZE // 3, 2)
        top, left = rng.integers(0, SIZE, 2)
        rows = np.arange(top, top + height) % SIZE
        columns = np.arange(left, left + width) % SIZE
        mask[np.ix_(rows, columns)] = True
    return mask


def _shading(rng: np.random.Generator) -> Texels:
    """Blank paint: slow changes of brightness far below any threshold."""
    return _normalised(_smooth_noise(SIZE / 12, rng)) * np.float32(_SHADING / LOG_CONTRAST)


def _smooth_noise(sigma: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Periodic noise of unit variance, smoothed over `sigma` texels."""
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE)))
    filtered = ndimage.fourier_gaussian(spectrum, sigma, n=SIZE)
    image = np.fft.irfft2(filtered, (SIZE, SIZE))
    return np.asarray((image - image.mean()) / image.std())


def _phase(down: int, right: int) -> NDArray[np.float64]:
    rows, columns = np.mgrid[:SIZE, :SIZE] * (2 * np.pi / SIZE)
    return np.asarray(down * rows + right * columns)


def _normalised(image: NDArray[np.float64]) -> Texels:
    """Zero mean, and the contrast of the dead leaves."""
    return np.asarray(LOG_CONTRAST * (image - image.mean()) / image.std(), np.float32)
