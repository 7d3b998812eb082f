"""Gaussian smoothing of images, in numba."""

import numba
import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

_REACH = 6  # px of an image on either side of the middle of a smoothing kernel, at most


def gaussian(sigma: float) -> F32:
    """Sampled Gaussian with sum 1, to 2.5 sigma on either side."""
    reach = int(np.ceil(2.5 * sigma))
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return (taps / taps.sum()).astype(np.float32)


def outwards(taps: F32) -> F32:
    """Bring a symmetric kernel of at most 13 taps to the form that `smooth` takes, (7,)."""
    middle = len(taps) // 2
    result = np.zeros(_REACH + 1, np.float32)
    result[: middle + 1] = taps[middle:]
    return result


@numba.njit(cache=True, fastmath=True, nogil=True)
def smooth(images: F32, taps: F32) -> None:
    """Convolve images with a symmetric kernel along columns and rows, in place; zero outside.

    Args:
        images: (n, h, w).
        taps: (7,) from the middle outwards: always as many, so that the loops over them are
            unrolled.
    """
    number, h, w = images.shape
    padded = np.zeros((h + 2 * _REACH, w), np.float32)
    row = np.zeros(w + 2 * _REACH, np.float32)
    for n in range(number):
        image = images[n]
        padded[_REACH:-_REACH] = image
        for i in range(h):
            for j in range(w):
                total = taps[0] * padded[i + _REACH, j]
                for k in range(1, _REACH + 1):
                    total += taps[k] * (padded[i + _REACH - k, j] + padded[i + _REACH + k, j])
                row[j + _REACH] = total
            for j in range(w):
                total = taps[0] * row[j + _REACH]
                for k in range(1, _REACH + 1):
                    total += taps[k] * (row[j + _REACH - k] + row[j + _REACH + k])
                image[i, j] = total
