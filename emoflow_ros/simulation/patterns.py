"""Textures of the random recordings: natural ones, printed ones, and blank paint."""

from collections.abc import Callable
from importlib import import_module

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from emoflow_ros.errors import InputError
from emoflow_ros.simulation.factors import TEXTURE_KINDS, Factors
from emoflow_ros.simulation.textures import (
    LOG_CONTRAST,
    SIZE,
    TextureSet,
    paint_leaves,
    texture_set,
)

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
_DARKEST = 10.0  # of 255: what no photograph shows below

Texels = NDArray[np.float32]


def random_textures(factors: Factors) -> TextureSet:
    """Paint the textures of a random recording: PAINTED patterns, then the blank one.

    The first patterns are of the recording's kind, the last two of any kind. Each covers its
    wall only in part, as posters and shelves do; the rest is blank.
    """
    rng = factors.generator("textures")
    # A plane has nothing else to look at.
    blank = min(factors.blank_share, 0.5) if factors.scene == "plane" else factors.blank_share
    images = []
    for k in range(PAINTED):
        kind = factors.texture if k < PAINTED - 2 else TEXTURE_KINDS[int(rng.integers(6))]
        pattern = _PAINTERS[kind](rng)
        mask = _posters(1 - blank, rng)
        images.append(np.where(mask, pattern, _shading(rng)).astype(np.float32))
    return texture_set([*images, _shading(rng)])


def _leaves(rng: np.random.Generator) -> Texels:
    return paint_leaves(rng)


def _blotches(rng: np.random.Generator) -> Texels:
    """Clouds without any sharp edge."""
    image = sum(_smooth_noise(sigma, rng) * sigma for sigma in (1.0 * FEATURE, 3.0 * FEATURE))
    return _normalised(np.asarray(image))


def _noise(rng: np.random.Generator) -> Texels:
    """Grain as of asphalt, plaster or a carpet."""
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
    """A part of a photograph that scikit-image ships, mirrored so that it goes on evenly.

    Raises:
        InputError: scikit-image is not installed.
    """
    name = str(rng.choice(_PHOTOS))
    try:
        data = import_module("skimage.data")
    except ImportError:
        raise InputError(
            "texture photo", "scikit-image is not installed", "pip install scikit-image"
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
